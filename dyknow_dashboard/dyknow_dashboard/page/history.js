'use strict';
// The failures that the server keeps: they are asked for over HTTP when they are looked at.

class KeptFailures {
  constructor() {
    this.before = null;
    this.shown = [];
    this.asked = 0;
    this.table = new KeyedTable($('history-table'), ['known at', 'formula', 'verdict', 'why', 'acknowledged', ''],
      'The history has no such failure.');
    $('history-by').value = localStorage.getItem('operator') ?? '';
    for (const id of ['history-name', 'history-day']) $(id).addEventListener('input', () => this.show(null));
    $('history-older').addEventListener('click', () => this.show(this.next));
    $('history-acknowledge').addEventListener('click', () => this.ask('acknowledge', this.ids(false)));
    $('history-clear').addEventListener('click', () => this.ask('clear', this.ids(true)));
  }

  // Takes the state of the history, which has changed.
  update(state) {
    this.fault = state.fault;
    setText($('tab-history'), state.unacknowledged ? `History (${state.unacknowledged})` : 'History');
    setText($('history-count'), `${state.count} kept, ${state.unacknowledged} not acknowledged`);
    setText($('history-fault'), state.fault);
    this.show(this.before);
  }

  // Shows the failures with ids below one; null: the latest.
  async show(before) {
    this.before = before;
    if ($('history').hidden || this.fault) return;
    const filter = new URLSearchParams({name: $('history-name').value, ...spanOf($('history-day').value)});
    $('history-junit').hidden = !filter.has('from');
    $('history-junit').href = `api/junit?${filter}`;
    if (before) filter.set('before', before);
    filter.set('limit', 100);
    this.asked += 1;
    const {asked} = this;
    const answer = await answerOf(fetch(`api/history?${filter}`));
    if (asked !== this.asked) return;  // Another one was sent since.
    setText($('history-answer'), answer.error ?? '');
    this.shown = answer.failures ?? [];
    this.next = answer.next;
    $('history-older').hidden = !this.next;
    this.table.update(this.shown.map((each) => this.row(each)));
  }

  row(failure) {
    const isSeen = failure.acknowledged_at !== null;
    const button = isSeen ? {text: 'Clear', act: () => this.ask('clear', [failure.id])}
      : {text: 'Acknowledge', act: () => this.ask('acknowledge', [failure.id])};
    const [first] = failure.explanation.split('\n', 1);
    return {
      key: failure.id,
      cells: [
        dateText(failure.known_at), failure.name,
        {text: failure.verdict, kind: `word ${failure.event === 'false' ? 'false' : 'error'}`}, first,
        isSeen ? `${failure.acknowledged_by}, ${dateText(failure.acknowledged_at)}` : '',
        this.readOnly ? '' : button,
      ],
      more: [
        ['formula', failure.formula], ['why', failure.explanation], ['asked at', dateText(failure.started)],
        ['valid time', failure.valid_time === null ? '' : dateText(failure.valid_time)],
      ],
    };
  }

  ids(isSeen) {
    return this.shown.filter((each) => (each.acknowledged_at !== null) === isSeen).map((each) => each.id);
  }

  async ask(action, ids) {
    const by = $('history-by').value.trim();
    if (action === 'acknowledge' && !by) {
      setText($('history-answer'), 'Say who you are first.');
      $('history-by').focus();
      return;
    }
    localStorage.setItem('operator', by);
    const answer = await request(action, action === 'clear' ? {ids} : {ids, by});
    setText($('history-answer'), answer.error ?? '');  // All pages are told of the change.
  }
}

// Returns the begin and the end of a day as nanoseconds since 1970: it may have 23 or 25 hours here.
function spanOf(day) {
  const [year, month, date] = day.split('-').map(Number);
  const begin = (number) => (isUtc ? Date.UTC(year, month - 1, number) : new Date(year, month - 1, number).getTime());
  return day ? {from: `${begin(date)}000000`, to: `${begin(date + 1)}000000`} : {};
}

// Returns the date and the time of nanoseconds since 1970; seconds if they are of a simulation.
function dateText(nanoseconds) {
  if (nanoseconds < 1e18) return `${(nanoseconds / 1e9).toFixed(3)} s`;
  const moment = Math.floor(nanoseconds / 1e6);
  const shift = isUtc ? 0 : new Date(moment).getTimezoneOffset() * 60000;
  return new Date(moment - shift).toISOString().slice(0, 23).replace('T', ' ');
}
