'use strict';
// Draws the signals of a formula with plotly, for reports and the live page.

// A drawing has an axis (its title), a range of time, marks and panels. The data stores a signal of
// several formulas once; a drawing has the signals themselves.
function drawingOf(data, number) {
  const formula = data.formulas[number];
  return {
    axis: `time (${data.unit[formula.recording]})`, range: formula.range, marks: formula.marks,
    panels: formula.panels.map((panel) => ({
      ...panel, signals: panel.signals.map((index) => data.signals[index]),
    })),
  };
}

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
  return panel.signals.map((signal, number) => {
    const words = signal.words.length ? signal.v.map((v) => signal.words[v] ?? v) : undefined;
    return {
      x: signal.t, y: signal.v, text: words, mode: 'lines', name: signal.name, showlegend: false,
      line: {color: COLOURS[number % 3], width: 1.6, shape: words ? 'hv' : 'linear'},
      customdata: signal.t.map((_, index) => [signal.low[index], signal.high[index]]),
      hovertemplate: (words ? '%{text}' : '%{y}') + ' at %{x}'
        + (signal.low.length ? ', from %{customdata[0]} to %{customdata[1]}' : '') + '<extra></extra>',
    };
  });
}

// The times in which relations held: a row for each.
function relationsOf(panel, marks) {
  const spans = panel.relations.flatMap((name, row) => (marks.held[name] ?? []).map((span) => [row, span]));
  return {
    x: spans.flatMap(([, [start, end]]) => [start, end, null]), y: spans.flatMap(([row]) => [row, row, null]),
    text: spans.flatMap(([row]) => [panel.relations[row], panel.relations[row], '']),
    mode: 'lines+markers', line: {color: COLOURS[0], width: 10}, marker: {color: COLOURS[0], size: 5},
    showlegend: false, hovertemplate: '%{text} at %{x}<extra></extra>',
  };
}

// The interval in which a signal is possible, one area for each of its lines without gaps.
function bandsOf(panel) {
  return panel.signals.map((signal, number) => {
    const x = [], y = [];
    let start = 0;
    signal.low.concat(null).forEach((low, end) => {
      if (low !== null && signal.high[end] !== null) return;
      const [t, lows, highs] = [signal.t, signal.low, signal.high].map((each) => each.slice(start, end));
      if (t.length) {
        x.push(...t, ...t.reverse(), null);
        y.push(...highs, ...lows.reverse(), null);
      }
      start = end + 1;
    });
    return {
      x, y, mode: 'lines', fill: 'toself', fillcolor: COLOURS[number % 3] + '48', showlegend: false,
      hoverinfo: 'skip', line: {width: 0},
    };
  });
}

function unknownOf(panel, marks) {
  // The times in which a signal has no value, hatched.
  const spans = panel.signals.flatMap((signal) => marks.unknown[signal.name] ?? []);
  return {
    x: spans.flatMap(([start, end]) => [start, start, end, end, null]),
    y: spans.flatMap(() => [0, 1, 1, 0, null]),
    yaxis: 'y2', mode: 'lines', fill: 'toself', showlegend: false, hoverinfo: 'skip',
    line: {width: 0}, fillpattern: {shape: '/', size: 6, fgcolor: '#7f7f7f', bgcolor: 'transparent'},
  };
}

function statesOf(panel, marks) {
  // The deciding states, as points on the signals.
  const names = panel.signals.map((signal) => signal.name);
  const points = !panel.is_decisive ? [] : marks.deciding.flatMap((state) =>
    names.filter((name) => state.values[name] != null)
      .map((name) => [state.time, state.values[name], state.verdict]));
  return {
    x: points.map((p) => p[0]), y: points.map((p) => p[1]), text: points.map((p) => p[2]),
    mode: 'markers', cliponaxis: false, showlegend: false, hovertemplate: '%{text}: %{y} at %{x}<extra></extra>',
    marker: {size: 11, color: '#d55e00', line: {width: 2, color: '#ffffff'}, symbol: 'diamond'},
  };
}

function layoutOf(panel, drawing) {
  const marks = drawing.marks;
  const rows = panel.relations ?? [];
  const words = rows.length ? rows : panel.signals[0].words;
  const shapes = [
    ...(panel.is_decisive ? marks.windows : []).map((each) => band(each, '#56b4e9', 0.22, 'dash')),
    ...marks.pending.map((each) => band(each, '#56b4e9', 0.3, 'dash')),
    ...marks.gaps.map((each) => band(each, '#7f7f7f', 0.35)),
    ...marks.violations.map((each) => line(each, 'dot', 2, '#9b5fc0')),
    // In the panels of objects that have not decided, the line only shows the time.
    ...marks.deciding.map((each) => line(each.time, 'solid', panel.is_decisive ? 2 : 1, '#d55e00')),
    ...panel.thresholds.map((each) => ({
      type: 'line', x0: 0, x1: 1, xref: 'paper', y0: each.value, y1: each.value,
      line: {dash: 'dash', width: 1.6, color: '#d55e00'},
    })),
  ];
  const range = drawing.range;
  // The texts of thresholds are at the right, unless a state there has decided.
  const isLate = marks.deciding.some((each) => each.time > range[0] + 0.8 * (range[1] - range[0]));
  const annotations = [
    ...panel.thresholds.map((each) => label(each.text, {
      x: isLate ? 0 : 1, xref: 'paper', xanchor: isLate ? 'left' : 'right', y: each.value, yanchor: 'bottom',
    })),
    ...marks.deciding.slice(0, panel.is_decisive ? 1 : 0).map((each) => label(each.verdict, {
      x: each.time, y: 1, yref: 'paper', yanchor: 'bottom',
      xanchor: each.time > (range[0] + range[1]) / 2 ? 'right' : 'left',
    })),
  ];
  return {
    shapes, annotations, hovermode: 'closest', dragmode: isTouched ? false : 'zoom',
    margin: {l: 54, r: 12, t: 20, b: 36}, paper_bgcolor: 'transparent', plot_bgcolor: 'transparent',
    font: {size: 11, family: 'system-ui, sans-serif'},
    xaxis: {range: [...range], title: {text: drawing.axis, standoff: 4}, zeroline: false},
    yaxis: {
      automargin: true, zeroline: false, title: {text: panel.unit, standoff: 4},
      autorangeoptions: {include: panel.thresholds.map((each) => each.value)},
      ...(words.length ? {tickvals: words.map((_, n) => n), ticktext: words} : {}),
      ...(rows.length ? {range: [rows.length - 0.5, -0.5]} : {}),
    },
    yaxis2: {overlaying: 'y', range: [0, 1], visible: false, fixedrange: true},
  };
}

// Draws a panel into an element, or draws it again after a change.
function drawPanel(element, panel, drawing) {
  const rows = panel.relations?.length;
  if (rows) element.style.height = `${Math.max(140, 64 + 18 * rows)}px`;
  const traces = rows ? [relationsOf(panel, drawing.marks)] : [
    ...tracesOf(panel), statesOf(panel, drawing.marks), unknownOf(panel, drawing.marks),
    ...bandsOf(panel),
  ];
  return Plotly.react(element, traces, layoutOf(panel, drawing),
    {responsive: true, displayModeBar: false});
}
