'use strict';
// Runs the code of the history page over a document that keeps texts only: a JSON line for each step.

const {readFileSync} = require('fs');
const vm = require('vm');
const document_ = require('./fake_document.js');

const [folder] = process.argv.slice(2);
const stored = new Map();
const requests = [];
let answers = {};

const sandbox = {
  document: document_, URLSearchParams, console,
  localStorage: {getItem: (name) => stored.get(name) ?? null, setItem: (name, value) => stored.set(name, value)},
  async fetch(path, options) {
    requests.push(options ? `${path} ${options.body}` : path);
    const answer = answers[path.split('?')[0]];
    return {json: async () => answer};
  },
};
vm.createContext(sandbox);
for (const name of ['elements.js', 'history.js']) vm.runInContext(readFileSync(`${folder}/${name}`, 'utf8'), sandbox);

const $ = (id) => document_.getElementById(id);
const settled = () => new Promise((resolve) => { setTimeout(resolve, 0); });

function say(step) {
  const rows = $('history-table').children[0].children[1].children.map((each) => each.children.map((cell) => cell.shown));
  const texts = ['tab-history', 'history-count', 'history-fault', 'history-answer'].map((id) => $(id).textContent);
  console.log(JSON.stringify({step, rows, texts, older: !$('history-older').hidden, requests: requests.splice(0)}));
}

async function main() {
  const failure = {
    id: 7, name: 'power', formula: 'always p', event: 'false', verdict: 'false', started: 1789999999000000000,
    valid_time: 1790000000000000000, known_at: 1790000000123456789, explanation: 'p is false\nat 1 s',
    acknowledged_by: null, acknowledged_at: null,
  };
  answers['api/history'] = {failures: [failure], next: 7};
  vm.runInContext('setZone(true); var kept = new KeptFailures();', sandbox);
  $('history').hidden = true;
  const state = {fault: '', count: 3, unacknowledged: 2, version: 1};
  sandbox.kept.update(state);
  await settled();
  say('hidden');
  $('history').hidden = false;
  sandbox.kept.show(null);
  await settled();
  say('shown');
  const button = () => $('history-table').children[0].children[1].children[0].children[5].children[0];
  button().onclick();
  await settled();
  say('who');
  $('history-by').value = ' Ada ';
  answers['api/acknowledge'] = {acknowledged: 1};
  button().onclick();
  await settled();
  answers['api/history'] = {failures: [{...failure, acknowledged_by: 'Ada', acknowledged_at: 1790000001000000000}], next: null};
  sandbox.kept.update({...state, unacknowledged: 0});
  await settled();
  say('acknowledged');
  answers['api/clear'] = {error: 'the page is read-only'};
  $('history-clear').handlers.click();
  await settled();
  say('refused');
  $('history-name').value = 'po&w';
  $('history-day').value = '2026-03-29';
  $('history-name').handlers.input();
  await settled();
  say($('history-junit').href);
  sandbox.kept.update({...state, fault: 'the file is damaged'});
  await settled();
  say('fault');
}

main();
