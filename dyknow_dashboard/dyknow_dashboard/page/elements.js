'use strict';
// Elements of the page. All texts are inserted as text, never as HTML.

function $(id) {
  return document.getElementById(id);
}

// Makes an element; children are elements or texts.
function make(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name === 'class') made.className = value;
    else if (name.startsWith('on')) made.addEventListener(name.slice(2), value);
    else if (value === true) made.setAttribute(name, '');
    else if (value !== false && value != null) made.setAttribute(name, value);
  }
  made.append(...children);
  return made;
}

// Sets a text only if it differs, so that a selection in it stays.
function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

// Sets a text in which places may be marked by a caret below them: all other lines wrap.
function setMarkedText(element, text) {
  if (element.textContent === text) return;
  const lines = text.split('\n');
  const isCaret = (number) => /^\s*\^$/.test(lines[number] ?? '');
  element.replaceChildren(...lines.flatMap((each, number) => [
    number ? '\n' : '', isCaret(number) || isCaret(number + 1) ? each : make('span', {}, each),
  ]));
}

function setClass(element, name) {
  if (element.className !== name) element.className = name;
}

let isUtc = localStorage.getItem('zone') === 'UTC';

function setZone(utc) {
  isUtc = utc;
  localStorage.setItem('zone', isUtc ? 'UTC' : 'local');
  setText($('zone'), isUtc ? 'UTC' : 'local time');
}

// Returns a time as an offset and on the clock: "13.662 s, 14:31:32.521".
function momentText(moment) {
  if (moment?.clock == null) return moment?.since ?? '';
  const shift = isUtc ? 0 : new Date(moment.clock).getTimezoneOffset() * 60000;
  return `${moment.since}, ${new Date(moment.clock - shift).toISOString().slice(11, 23)}`;
}

let plotly = null;

// Loads plotly when the first plot is opened, as it has 5 MB.
function loadPlotly() {
  plotly ??= new Promise((resolve) => {
    const onerror = () => { plotly = null; };  // The next plot tries again.
    document.head.append(make('script', {src: 'plotly.js', onload: resolve, onerror}));
  });
  return plotly;
}

// A table whose rows are updated in place, so that the focus and what is open stay.
//
// A row has a key, cells (texts, {text, kind}, or {text, act} for a button) and `more`: pairs of a
// label and a text, which are shown when the row is opened.
class KeyedTable {
  constructor(place, heads, empty) {
    this.heads = heads;
    this.rows = new Map();
    this.body = make('tbody');
    const head = make('tr', {}, ...heads.map((each) => make('th', {scope: 'col'}, each)));
    this.table = make('table', {class: 'cards'}, make('thead', {}, head), this.body);
    this.empty = make('p', {class: 'soft'}, empty);
    place.append(this.table, this.empty);
  }

  update(rows) {
    const seen = new Set();
    let before = null;
    for (const row of rows) {
      seen.add(row.key);
      const entry = this.rows.get(row.key) ?? this.add(row);
      this.fill(entry, row);
      const expected = before ? before.nextSibling : this.body.firstChild;
      if (entry.element !== expected) this.body.insertBefore(entry.element, expected);
      before = entry.element;
    }
    for (const [key, entry] of this.rows) {
      if (!seen.has(key)) {
        entry.element.remove();
        this.rows.delete(key);
      }
    }
    this.table.hidden = !rows.length;
    this.empty.hidden = !!rows.length;
  }

  add(row) {
    const texts = row.cells.map((each) => each.act ? make('button', {type: 'button'}) : make('span'));
    const cells = this.heads.map((head, number) => make('td', {'data-label': head}, texts[number]));
    const entry = {element: make('tr', {}, ...cells), cells, texts};
    if (row.more) {
      entry.summary = make('summary');
      entry.more = make('div', {class: 'more'});
      cells[0].replaceChildren(make('details', {}, entry.summary, entry.more));
      entry.summary.append(texts[0]);
      entry.values = row.more.map(([label]) => {
        const value = make('dd');
        const line = make('dl', {}, make('dt', {}, label), value);
        entry.more.append(line);
        return {line, value};
      });
    }
    this.rows.set(row.key, entry);
    return entry;
  }

  fill(entry, row) {
    row.cells.forEach((cell, number) => {
      const {text, kind, act} = typeof cell === 'object' ? cell : {text: cell, kind: ''};
      setText(entry.texts[number], String(text));
      entry.texts[number].onclick = act ?? null;
      setClass(entry.texts[number], kind ?? '');
      setClass(entry.cells[number], String(text) ? '' : 'blank');
    });
    (row.more ?? []).forEach(([, text], number) => {
      setText(entry.values[number].value, text);
      entry.values[number].line.hidden = !text;
    });
  }
}

// Sends a request to the server, and returns its answer, or {error}.
function request(action, document_) {
  return answerOf(fetch(`api/${action}`, {
    method: 'POST', headers: {'Content-Type': 'application/json'}, body: JSON.stringify(document_),
  }));
}

async function answerOf(response) {
  try {
    return await (await response).json();
  } catch {
    return {error: 'the server does not answer'};
  }
}
