'use strict';
// The list of formulas: a row for each, and its details with signals when it is opened.

const MAX_OPEN = 8;
const LABELLED = 0.2;

class FormulaList {
  // Earlier runs have a place of their own. onOpened is called when other formulas are open.
  constructor(place, earlier, onOpened) {
    this.place = place;
    this.earlier = earlier;
    this.wanted = '';
    this.onOpened = onOpened;
    this.rows = new Map();
    this.canSave = false;
    this.readOnly = false;
  }

  // The keys of the opened formulas, those opened first at the beginning.
  get opened() {
    return [...this.rows.values()].filter((each) => each.element.open)
      .sort((a, b) => a.openedAt - b.openedAt).map((each) => each.id);
  }

  update(rows) {
    const seen = new Set(rows.map((each) => each.id));
    for (const [id, row] of this.rows) {
      if (!seen.has(id)) {
        row.remove();
        this.rows.delete(id);
      }
    }
    const before = new Map();
    for (const each of rows) {
      let row = this.rows.get(each.id);
      if (!row) {
        row = new FormulaRow(each.id, this);
        this.rows.set(each.id, row);
      }
      row.update(each);
      const place = each.group === 'earlier' ? this.earlier : this.place;
      const expected = before.has(place) ? before.get(place).nextSibling : place.firstChild;
      if (row.element !== expected) place.insertBefore(row.element, expected);
      before.set(place, row.element);
    }
  }

  // Shows the formulas whose name, state or text has a text.
  filter(text) {
    this.wanted = text.toLowerCase();
    this.refresh();
  }

  refresh() {
    for (const row of this.rows.values()) {
      row.update(row.row);
      if (row.latest) row.details(row.latest);
    }
  }

  toggled(row) {
    if (row.element.open) {
      row.openedAt = performance.now();
      const opened = this.opened;
      if (opened.length > MAX_OPEN) this.rows.get(opened[0]).element.open = false;
    }
    this.onOpened();
  }

  get(id) {
    return this.rows.get(id);
  }
}

class FormulaRow {
  constructor(id, list) {
    this.id = id;
    this.list = list;
    this.openedAt = 0;
    this.drawing = null;
    this.word = make('span', {class: 'word'});
    this.name = make('span', {class: 'name'});
    this.text = make('code');
    this.note = make('span', {class: 'note'});
    this.strip = make('div', {class: 'strip', role: 'img'});
    this.body = make('div', {class: 'body'});
    this.sure = make('i');
    this.unsure = make('i', {class: 'unsure'});
    this.interval = make('span');
    this.chance = make('span', {class: 'chance'},
      make('span', {class: 'bar', 'aria-hidden': 'true'}, this.sure, this.unsure), this.interval);
    const head = make('div', {class: 'head'}, this.word,
      make('div', {}, this.name, this.text, this.note, this.chance));
    this.element = make('details', {class: 'formula'},
      make('summary', {class: 'row'}, head, this.strip), this.body);
    this.element.addEventListener('toggle', () => list.toggled(this));
    this.fillBody();
  }

  fillBody() {
    this.whole = make('code');
    this.why = make('div', {class: 'why'});
    this.facts = make('p', {class: 'soft'});
    this.residual = make('p', {class: 'residual'});
    this.map = make('div');
    this.panels = make('div', {class: 'panels'});
    [this.margins, this.probabilities] = [1, 2].map(() => make('div', {class: 'panels few'}));
    this.tables = make('div');
    this.answer = make('p', {role: 'status'});
    this.cancel = make('button', {type: 'button', onclick: () => this.ask('cancel')}, 'Cancel');
    this.save = make('button', {type: 'button', onclick: () => this.ask('save')}, 'Save black box');
    this.actions = make('div', {class: 'actions'}, this.cancel, this.save);
    this.unseen = make('p', {class: 'soft', hidden: true}, 'There are no signals: no state has come since the server of this page was started.');
    this.body.append(make('p', {}, this.whole), this.why, this.facts, this.residual, this.actions,
      this.answer, this.map, this.unseen, this.panels, this.margins, this.probabilities, this.tables);
  }

  remove() {
    for (const plot of this.element.querySelectorAll('.js-plotly-plot')) Plotly.purge(plot);
    this.element.remove();
  }

  async ask(action) {
    setText(this.answer, 'asked…');
    const answer = await request(action, {name: this.fullName ?? this.row.name});
    const done = action === 'cancel' ? `cancelled ${answer.cancelled}` : `saved: ${answer.paths?.join(', ')}`;
    setText(this.answer, answer.error ?? done);
  }

  update(row) {
    this.row = row;
    const kind = row.kind === 'warning' ? 'undecided warning' : row.kind;
    setText(this.word, row.state);
    setClass(this.word, `word ${kind}`);
    const isNamed = row.name !== row.formula;
    setText(this.name, isNamed ? row.name : '');
    setText(this.text, row.formula);
    setText(this.whole, row.formula);
    setText(this.note, row.text === row.state ? '' : row.text);
    const texts = [row.name, row.formula, row.state, row.group];
    this.element.hidden = !texts.some((each) => each.toLowerCase().includes(this.list.wanted));
    const facts = [
      row.failed_at ? `failed at ${momentText(row.failed_at)}` : '',
      row.failures > 1 ? `${row.failures} times` : '',
      `${row.states} states`, `asked ${duration(row.since)} ago`, row.every_state ? 'asked at every state' : '',
      row.margin ? `margin ${row.margin}` : '', row.plan ? `plan ${row.plan}` : '',
    ];
    setText(this.facts, facts.filter(Boolean).join('; '));
    this.cancel.hidden = !row.is_running || this.list.readOnly;
    this.save.hidden = !this.list.canSave || this.list.readOnly;
    this.actions.hidden = this.cancel.hidden && this.save.hidden;
    this.drawStrip(row.strip);
    this.drawProbability(row.probability);
  }

  // The bar is full up to the lower bound, and hatched up to the upper one.
  drawProbability(interval) {
    this.chance.hidden = !interval;
    if (!interval) return;
    setText(this.interval, `P ${interval.text}`);
    this.sure.style.width = `${100 * interval.lower}%`;
    this.unsure.style.width = `${100 * (interval.upper - interval.lower)}%`;
  }

  drawStrip(segments) {
    const text = JSON.stringify(segments);
    if (text === this.segments) return;
    this.segments = text;
    this.strip.replaceChildren(...segments.map(([start, end, outcome]) => {
      const mark = make('i', {class: `is-${outcome}`, title: outcome}, end - start > LABELLED ? outcome : '');
      mark.style.left = `${100 * start}%`;
      mark.style.width = `${100 * (end - start)}%`;
      return mark;
    }));
    const words = segments.slice(-6).map(([start, end, outcome]) =>
      `${outcome} from ${ago(start)} to ${ago(end)}`);
    this.strip.setAttribute('aria-label', words.join('; ') || 'no verdict in the last 5 minutes');
  }

  details(details) {
    this.latest = details;
    this.fullName = details.name;
    setMarkedText(this.why, details.explanation || details.waits_for || this.row.text);
    // A caret stands under its place.
    const isMarked = /^\s*\^$/m.test(this.why.textContent);
    setClass(this.why, `why is-${this.row.kind}${isMarked ? ' marked' : ''}`);
    const parts = [
      details.decided_at && !this.row.failed_at ? `decided at ${momentText(details.decided_at)}` : '',
      details.residual ? `remains: ${details.residual}` : '',
      details.waits_for && details.explanation ? `waits for: ${details.waits_for}` : '',
    ];
    setText(this.residual, parts.filter(Boolean).join('\n'));
    this.unseen.hidden = Boolean(this.drawing?.panels.length);
    this.fillTables(details);
    this.drawBounds('margin', this.margins, details.margins, [{value: 0, text: '0'}]);
    const {required} = details;
    this.drawBounds('probability', this.probabilities, required.length ? details.probabilities : [], required);
  }

  fillTables(details) {
    const text = JSON.stringify([isUtc, details.episodes, details.groundings, details.events]);
    if (text === this.tabled) return;
    this.tabled = text;
    this.tables.replaceChildren();
    if (details.episodes.length) {
      this.addTable('Episodes', ['from', 'to', 'states', 'why'], details.episodes.map((each) =>
        [momentText(each.begin), momentText(each.end) || 'now', each.states, each.explanation]));
    }
    if (details.groundings.length) {
      this.addTable('Streams', ['feature', 'stream in use', 'stand-ins'], details.groundings.map((each) =>
        [each.symbol, each.stream, each.stand_ins.join('\n') || 'none']));
    }
    if (details.events.length) {
      this.tables.append(make('h3', {}, 'Events'), ...details.events.map((each) => make('p', {}, each)));
    }
  }

  addTable(title, heads, rows) {
    const place = make('div');
    this.tables.append(make('h3', {}, title), place);
    new KeyedTable(place, heads, '').update(rows.map((cells, key) => ({key, cells})));
  }

  // Shows an image as SVG; an empty text removes it.
  drawMap(image) {
    this.map.replaceChildren(...(image
      ? [new DOMParser().parseFromString(image, 'image/svg+xml').documentElement] : []));
  }

  // Draws all panels anew.
  draw(message) {
    this.signals = message.signals;
    this.drawing = drawingOf({...message, unit: ['s']}, 0);
    this.drawing.axis = 'time since it was asked (s)';
    for (const plot of this.panels.querySelectorAll('.js-plotly-plot')) Plotly.purge(plot);
    this.panels.classList.toggle('few', message.captions.length <= 2);
    this.plots = this.drawing.panels.map(() => make('div', {class: 'plot'}));
    this.panels.replaceChildren(...message.captions.map((caption, number) => {
      const names = caption.names.map((name) => make('span', {class: 'signal'}, name));
      const decides = caption.is_decisive ? [' ', make('span', {class: 'word error-free'}, 'decides')] : [];
      const objects = caption.objects ? [make('b', {}, caption.objects), ...decides, ' '] : [];
      const title = make('div', {}, ...objects, caption.title);
      return make('figure', {}, make('figcaption', {}, title, ...names), this.plots[number]);
    }), ...(message.omitted ? [make('p', {class: 'soft'}, `${message.omitted} more are not shown`)] : []));
    this.plots.forEach((plot) => VISIBLE.observe(plot));
    this.unseen.hidden = Boolean(this.plots.length);
    this.redraw(true);
  }

  // Adds the points of later states, and forgets those that have left the range.
  extend(message) {
    if (!this.drawing) return;
    const {range, marks} = message.formulas[0];
    Object.assign(this.drawing, {range, marks});
    message.signals.forEach((added, number) => {
      const signal = this.signals[number];
      const all = signal.t.concat(added.t);
      let first = 0;
      while (first < all.length - 1 && all[first + 1] < range[0]) first += 1;
      for (const each of ['t', 'v', 'low', 'high']) signal[each] = signal[each].concat(added[each]).slice(first);
    });
    this.redraw(false);
  }

  async redraw(all) {
    if (!this.element.open) return;
    await loadPlotly();
    this.drawing.panels.forEach((panel, number) => {
      const plot = this.plots[number];
      if (all || plot.dataset.visible) drawPanel(plot, panel, this.drawing);
    });
  }

  // Draws the bounds of a number of the whole formula over time.
  async drawBounds(title, place, bounds, thresholds) {
    place.hidden = !bounds.length;
    if (!bounds.length || !this.element.open) return;
    await loadPlotly();
    if (!place.plot) {
      place.plot = make('div', {class: 'plot'});
      const names = ['at least', 'at most'].map((name) => make('span', {class: 'signal'}, name));
      place.append(make('figure', {},
        make('figcaption', {}, make('b', {}, title), ' ', make('span', {}, ...names)), place.plot));
    }
    const [t, low, high] = [0, 1, 2].map((column) => bounds.map((each) => each[column]));
    const panel = {
      is_decisive: false, unit: '', thresholds,
      signals: [
        {name: 'at least', t, v: low, low, high, words: []},
        {name: 'at most', t, v: high, low: [], high: [], words: []},
      ],
    };
    const marks = {deciding: [], windows: [], pending: [], gaps: [], unknown: {}, violations: []};
    const range = [t[0], Math.max(t.at(-1), t[0] + 1)];
    drawPanel(place.plot, panel, {axis: 'time since it was asked (s)', range, marks});
  }
}

// Plots that are not seen are not drawn again.
const VISIBLE = new IntersectionObserver((entries) => {
  for (const entry of entries) {
    if (entry.isIntersecting) entry.target.dataset.visible = 'yes';
    else delete entry.target.dataset.visible;
  }
});

function duration(seconds) {
  if (seconds < 120) return `${seconds} s`;
  if (seconds < 7200) return `${Math.floor(seconds / 60)} min`;
  return `${Math.floor(seconds / 3600)} h`;
}

function ago(place) {
  const seconds = Math.round(300 * (1 - place));
  return seconds ? `${seconds} s ago` : 'now';
}
