'use strict';
// Draws the panels of a formula when its details are opened, and all of them to print.
const data = JSON.parse(document.getElementById('data').textContent);
const PRINT_WIDTH = 640;
const COLOURS = ['#3987e5', '#c98500', '#9085e9'];
const isTouched = matchMedia('(pointer: coarse)').matches;

function line(time, dash, width, color) {
  return {type: 'line', x0: time, x1: time, y0: 0, y1: 1, yref: 'paper', line: {dash, width, color}};
}

function band(span, fillcolor, opacity, dash) {
  return {
    type: 'rect', x0: span[0], x1: span[1], y0: 0, y1: 1, yref: 'paper', layer: 'below',
    fillcolor, opacity, line: {width: dash ? 1 : 0, dash: dash || 'solid', color: fillcolor},
  };
}

function label(text, position) {
  return {text, showarrow: false, font: {size: 11}, ...position};
}

function tracesOf(panel) {
  return panel.signals.map((index, number) => {
    const signal = data.signals[index];
    const words = signal.words.length ? signal.v.map((v) => signal.words[v] ?? v) : undefined;
    return {
      x: signal.t, y: signal.v, text: words, mode: 'lines', name: signal.name, showlegend: false,
      line: {color: COLOURS[number % 3], width: 1.6, shape: words ? 'hv' : 'linear'},
      hovertemplate: (words ? '%{text}' : '%{y}') + ' at %{x}<extra></extra>',
    };
  });
}

function statesOf(panel, marks) {
  // The deciding states, as points on the signals.
  const names = panel.signals.map((index) => data.signals[index].name);
  const points = !panel.is_decisive ? [] : marks.deciding.flatMap((state) =>
    names.filter((name) => state.values[name] != null)
      .map((name) => [state.time, state.values[name], state.verdict]));
  return {
    x: points.map((p) => p[0]), y: points.map((p) => p[1]), text: points.map((p) => p[2]),
    mode: 'markers', showlegend: false, hovertemplate: '%{text}: %{y} at %{x}<extra></extra>',
    marker: {size: 11, color: '#d55e00', line: {width: 2, color: '#ffffff'}, symbol: 'diamond'},
  };
}

function layoutOf(panel, formula) {
  const marks = formula.marks;
  const words = data.signals[panel.signals[0]].words;
  const shapes = [
    ...(panel.is_decisive ? marks.windows : []).map((each) => band(each, '#56b4e9', 0.22, 'dash')),
    ...marks.pending.map((each) => band(each, '#56b4e9', 0.3, 'dash')),
    ...marks.gaps.map((each) => band(each, '#7f7f7f', 0.35)),
    ...marks.violations.map((each) => line(each, 'dot', 2, '#9b5fc0')),
    ...marks.deciding.map((each) => line(each.time, 'solid', 2, '#d55e00')),
    ...panel.thresholds.map((each) => ({
      type: 'line', x0: 0, x1: 1, xref: 'paper', y0: each.value, y1: each.value,
      line: {dash: 'dash', width: 1.6, color: '#d55e00'},
    })),
  ];
  const range = formula.range;
  const annotations = [
    ...panel.thresholds.map((each) => label(each.text, {
      x: 1, xref: 'paper', xanchor: 'right', y: each.value, yanchor: 'bottom',
    })),
    ...marks.deciding.slice(0, 1).map((each) => label(each.verdict, {
      x: each.time, y: 1, yref: 'paper', yanchor: 'bottom',
      xanchor: each.time > (range[0] + range[1]) / 2 ? 'right' : 'left',
    })),
  ];
  return {
    shapes, annotations, hovermode: 'closest', dragmode: isTouched ? false : 'zoom',
    margin: {l: 54, r: 12, t: 20, b: 36}, paper_bgcolor: 'transparent', plot_bgcolor: 'transparent',
    font: {size: 11, family: 'system-ui, sans-serif'},
    xaxis: {range: [...range], title: {text: `time (${data.unit[formula.recording]})`, standoff: 4}, zeroline: false},
    yaxis: {
      automargin: true, zeroline: false,
      autorangeoptions: {include: panel.thresholds.map((each) => each.value)},
      ...(words.length ? {tickvals: words.map((_, n) => n), ticktext: words} : {}),
    },
  };
}

function draw(details) {
  const formula = data.formulas[details.dataset.formula];
  details.querySelectorAll('.plot:not(.js-plotly-plot)').forEach((element) => {
    const panel = formula.panels[element.dataset.panel];
    const traces = [...tracesOf(panel), statesOf(panel, formula.marks)];
    Plotly.newPlot(element, traces, layoutOf(panel, formula),
      {responsive: true, displayModeBar: false});
    element.on('plotly_relayout', (change) => follow(details, element, change));
  });
}

// The panels of a formula show the same times.
function follow(details, source, change) {
  const range = change['xaxis.autorange'] ? data.formulas[details.dataset.formula].range
    : [change['xaxis.range[0]'], change['xaxis.range[1]']];
  if (range[0] === undefined || source.dataset.follows) return;
  details.querySelectorAll('.js-plotly-plot').forEach((element) => {
    if (element === source && !change['xaxis.autorange']) return;
    element.dataset.follows = 'yes';
    Plotly.relayout(element, {'xaxis.range': [...range]}).then(() => delete element.dataset.follows);
  });
}

const all = [...document.querySelectorAll('details.formula')];
all.forEach((each) => each.addEventListener('toggle', () => each.open && draw(each)));
all.filter((each) => each.open).forEach(draw);

let closed = [];
addEventListener('beforeprint', () => {
  closed = all.filter((each) => !each.open);
  all.forEach((each) => { each.open = true; draw(each); });
  document.querySelectorAll('.js-plotly-plot').forEach((each) => Plotly.relayout(each, {width: PRINT_WIDTH}));
});
addEventListener('afterprint', () => {
  document.querySelectorAll('.js-plotly-plot').forEach((each) => Plotly.relayout(each, {width: null, autosize: true}));
  closed.forEach((each) => { each.open = false; });
});
