'use strict';
// Runs the code of the tables over messages about peers: a JSON line for each.

const {readFileSync} = require('fs');
const vm = require('vm');
const document_ = require('./fake_document.js');

const [folder, messages] = process.argv.slice(2);
const sandbox = {document: document_, localStorage: {getItem: () => null}};
vm.createContext(sandbox);
for (const name of ['elements.js', 'tables.js']) vm.runInContext(readFileSync(`${folder}/${name}`, 'utf8'), sandbox);
vm.runInContext('var tables = new Tables();', sandbox);

const $ = (id) => document_.getElementById(id);
const OLD = ['old', 'old-streams', 'old-graph', 'old-peers'];
for (const id of OLD) $(id).hidden = true;
for (const message of JSON.parse(messages)) {
  if (message.type === 'nodes') sandbox.tables.showNodes(message);
  else sandbox.tables.showPeers(message);
  const rows = $('peers-table').children[0].children[1].children.map((each) => each.children.map((cell) => cell.shown));
  const old = OLD.filter((id) => !$(id).hidden);
  console.log(JSON.stringify({hidden: $('federation').hidden, shares: $('shares').textContent, rows, old}));
}
