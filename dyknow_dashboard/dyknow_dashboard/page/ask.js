'use strict';
// The form that asks a formula: it is checked and completed while it is typed.

const CHECK_DELAY_MS = 150;

class AskForm {
  constructor() {
    this.field = $('formula');
    this.list = $('proposals');
    this.proposals = [];
    this.active = -1;
    this.asked = 0;
    this.timer = null;
    this.isDismissed = false;
    this.field.addEventListener('input', () => this.checkSoon());
    this.field.addEventListener('keydown', (event) => this.key(event));
    this.field.addEventListener('blur', () => this.hide());
    $('ask').addEventListener('submit', (event) => this.submit(event));
  }

  checkSoon() {
    this.isDismissed = false;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.check(), CHECK_DELAY_MS);
  }

  async check() {
    this.asked += 1;
    const number = this.asked;
    const found = await request('check', {text: this.field.value, cursor: this.field.selectionEnd});
    if (number !== this.asked) return;
    this.showFault(found.error ?? found.fault ?? '', found.notes ?? []);
    const isWanted = document.activeElement === this.field && !this.isDismissed;
    this.propose(isWanted ? found.proposals ?? [] : []);
  }

  showFault(fault, notes) {
    setMarkedText($('fault'), fault || notes.join('\n'));
    setClass($('fault'), fault ? 'bad' : 'note');
    this.field.setAttribute('aria-invalid', String(Boolean(fault)));
  }

  propose(proposals) {
    this.proposals = proposals;
    this.active = -1;
    this.list.replaceChildren(...proposals.map((each, number) => make('li', {
      role: 'option', id: `proposal-${number}`, 'aria-selected': 'false',
      onmousedown: (event) => { event.preventDefault(); this.insert(number); },
    }, make('b', {}, each.text), make('span', {class: 'soft'}, `${each.kind} ${each.note}`))));
    this.list.hidden = !proposals.length;
    this.field.setAttribute('aria-expanded', String(Boolean(proposals.length)));
    this.field.removeAttribute('aria-activedescendant');
  }

  hide() {
    this.isDismissed = true;  // An answer that comes later shows none.
    this.propose([]);
  }

  key(event) {
    if (event.key === 'Enter' && (event.ctrlKey || event.metaKey)) {
      event.preventDefault();
      $('ask').requestSubmit();
    } else if (event.key === 'Escape') {
      event.preventDefault();
      this.hide();
    } else if (!this.proposals.length) {
      return;
    } else if (event.key === 'ArrowDown' || event.key === 'ArrowUp') {
      event.preventDefault();
      const count = this.proposals.length;
      const step = event.key === 'ArrowDown' ? 1 : -1;
      this.mark(this.active < 0 && step < 0 ? count - 1 : (this.active + step + count) % count);
    } else if ((event.key === 'Enter' || event.key === 'Tab') && this.active >= 0) {
      event.preventDefault();
      this.insert(this.active);
    }
  }

  mark(number) {
    this.active = number;
    [...this.list.children].forEach((each, index) => each.setAttribute('aria-selected', String(index === number)));
    this.list.children[number].scrollIntoView({block: 'nearest'});
    this.field.setAttribute('aria-activedescendant', `proposal-${number}`);
  }

  insert(number) {
    const {text, from} = this.proposals[number];
    this.field.setRangeText(text, from, this.field.selectionEnd, 'end');
    this.hide();
    this.checkSoon();
  }

  async submit(event) {
    event.preventDefault();
    this.hide();
    setText($('asked'), 'asked…');
    setClass($('asked'), 'note');
    const answer = await request('ask', {
      formula: this.field.value, name: $('name').value, every_state: $('every').checked,
      margin: $('margin').checked, timeout_s: Number($('timeout').value),
    });
    const isFormula = answer.error && answer.error.includes('\n');
    if (isFormula) this.showFault(answer.error, []);
    setText($('asked'), answer.error ? (isFormula ? 'the formula was not asked' : answer.error) : 'it is being evaluated');
    setClass($('asked'), answer.error ? 'bad' : 'note');
  }
}
