// Draws the panels of a formula when its details are opened, and all of them to print.
const data = JSON.parse(document.getElementById('data').textContent);
const PRINT_WIDTH = 640;

// Reads plotly, which has 5 MB, when the first plot is opened.
function readPlotly() {
  if (window.Plotly) return;
  const script = document.createElement('script');
  script.textContent = document.getElementById('plotly').textContent;
  document.head.append(script);
}

function draw(details) {
  readPlotly();
  const drawing = drawingOf(data, details.dataset.formula);
  details.querySelectorAll('.plot:not(.js-plotly-plot)').forEach((element) => {
    drawPanel(element, drawing.panels[element.dataset.panel], drawing);
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
// The verdicts are shown before the first plot is drawn.
requestAnimationFrame(() => setTimeout(() => all.filter((each) => each.open).forEach(draw)));

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
