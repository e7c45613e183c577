'use strict';
// Alarms at failures of formulas, for operators who ask for them: a tone, a notification.

class Alarms {
  constructor() {
    this.failures = null;
    $('sound').addEventListener('change', () => { this.audio ??= new AudioContext(); });
    $('notify').addEventListener('change', () => this.askPermission());
  }

  async askPermission() {
    setText($('notice'), '');
    // Browsers have notifications on this machine or over HTTPS only.
    const answer = !$('notify').checked || await window.Notification?.requestPermission();
    if (answer === true || answer === 'granted') return;
    $('notify').checked = false;
    setText($('notice'), 'The browser permits no notifications here.');
  }

  // What had failed when the page was opened, or was evaluated earlier, is no news.
  update(rows) {
    const before = this.failures;
    this.failures = new Map(rows.map((each) => [each.id, each.failures]));
    const failed = before ? rows.filter((each) => each.group !== 'earlier' && each.failures > (before.get(each.id) ?? 0)) : [];
    if (!failed.length) return;
    if ($('sound').checked) this.beep();
    if ($('notify').checked) {
      const more = failed.length > 1 ? `, and ${failed.length - 1} more` : '';
      try {
        new Notification(`${failed[0].name}: ${failed[0].state}${more}`, {body: failed[0].text, tag: 'dyknow'});
      } catch {  // Some browsers of phones permit notifications, but show none of pages.
        setText($('notice'), 'This browser shows no notifications of pages.');
      }
    }
  }

  beep() {
    const tone = this.audio.createOscillator();
    tone.frequency.value = 880;
    tone.connect(this.audio.destination);
    tone.start();
    tone.stop(this.audio.currentTime + 0.4);
  }
}
