'use strict';
// The tables of streams, nodes and the ontology.

const LEVELS = {ok: 'true', warning: 'undecided warning', error: 'false', stale: 'undecided'};
const LINKS = {linked: 'true', stale: 'undecided warning', left: 'false'};
const PEER_HEADS = ['peer', 'link', 'silent', 'delay', 'clock', 'sent', 'received', 'lost', 'shares', 'asked for', 'given', 'fault'];
const STATES = {flowing: 'true', waiting: 'undecided warning', failed: 'false', registered: 'undecided'};
const REPORTERS = {old: 'stream_reasoning_coordinator', 'old-streams': 'stream_manager', 'old-graph': 'stream_manager', 'old-peers': 'federation'};

class Tables {
  constructor() {
    this.topics = new KeyedTable($('topics-table'),
      ['topic', 'rate', 'delay', 'lost', 'dropped', 'formulas'], 'No stream and no formula uses a topic.');
    this.streams = new KeyedTable($('streams-table'),
      ['stream', 'state', 'rate', 'delay', 'dropped', 'violations', 'stand-in for'], 'There is no stream besides DyKnow\'s own.');
    this.nodes = new KeyedTable($('nodes-table'), ['node', 'health', 'message'], 'No node is known.');
    this.diagnoses = new KeyedTable($('diagnoses-table'), ['name', 'level', 'message'],
      'Nobody else publishes on /diagnostics.');
    this.peers = new KeyedTable($('peers-table'), PEER_HEADS, 'No peer is known yet.');
    this.sorts = new KeyedTable($('sorts-table'), ['sort', 'below', 'objects'], 'There is no sort.');
    this.features = new KeyedTable($('features-table'), ['feature', 'below', 'streams'], 'There is no feature.');
    this.annotations = new KeyedTable($('annotations-table'), ['annotation', 'fault'], 'There is no annotation.');
    this.latest = null;
    $('own').addEventListener('change', () => this.latest && this.showStreams(this.latest));
  }

  showStreams(message) {
    this.latest = message;
    const shown = message.streams.filter((each) => !each.is_own || $('own').checked);
    const engines = message.engines.join(', ') || 'no stream processing engine is running';
    setText($('engines'), `${engines}${message.hidden ? `; ${message.hidden} more are not shown` : ''}`);
    this.topics.update(message.topics.map((each) => ({
      key: each.name,
      cells: [
        each.name, {text: `${each.rate} Hz`, kind: each.rate ? '' : 'warned'}, each.delay,
        {text: each.lost || '', kind: 'warned'}, {text: each.dropped || '', kind: 'warned'},
        each.formulas.join(', '),
      ],
      more: [
        ['why', each.message], ['received', String(each.received)],
        ['dropped', Object.entries(each.drops).map(([why, count]) => `${count} ${why}`).join(', ')],
        ['streams', each.streams.join(', ')],
      ],
    })));
    this.streams.update(shown.map((each) => ({
      key: each.name,
      cells: [
        each.shown, {text: each.state, kind: `word ${STATES[each.state]}`},
        each.rate == null ? '' : `${each.rate} Hz`, each.delay,
        {text: each.dropped || '', kind: 'warned'}, {text: each.violations || '', kind: 'warned'},
        each.stand_in_for.join(', '),
      ],
      more: [
        ['why', each.message], ['greatest delay', each.max_delay], ['samples', String(each.samples)],
        ['dropped', Object.entries(each.drops).map(([why, count]) => `${count} ${why}`).join(', ')],
        ['made of', each.sources.join(', ')], ['engine', each.engine], ['topic', each.topic],
        ['type', each.type], ['constraints', each.constraints], ['specification', each.specification],
      ],
    })));
  }

  showNodes(message) {
    this.nodes.update(message.nodes.map((each) => ({
      key: each.name,
      cells: [each.name, {text: each.level, kind: `word ${LEVELS[each.level]}`}, each.message],
      more: [['status', each.values.map(([key, value]) => `${key}: ${value}`).join('\n')]],
    })));
    this.diagnoses.update(message.diagnoses.map((each) => ({
      key: each.name,
      cells: [each.name, {text: each.level, kind: `word ${LEVELS[each.level]}`}, each.message],
    })));
    // A node that was not found yet warns for some seconds.
    const missing = message.nodes.filter((each) => !each.alive && each.level === 'error');
    const bad = message.nodes.filter((each) => each.level !== 'ok');
    for (const [id, node] of Object.entries(REPORTERS)) $(id).hidden = !missing.some((each) => each.name.endsWith(`/${node}`));
    const health = $('health');
    health.hidden = !message.nodes.length;
    setText(health, missing.length ? `${missing.length} of ${message.nodes.length} nodes missing`
      : bad.length ? `${bad.length} of ${message.nodes.length} not ok` : `${message.nodes.length} nodes ok`);
    setClass(health, `chip ${missing.length ? 'bad' : bad.length ? 'warn' : 'good'}`);
  }

  showPeers(message) {
    $('federation').hidden = !message.shares;
    setText($('shares'), `${message.shares}${message.hidden ? `; ${message.hidden} more peers are not shown` : ''}`);
    setText($('federation-faults'), message.faults.join('\n'));
    this.peers.update(message.peers.map((each) => ({
      key: each.peer,
      cells: PEER_HEADS.map((head) => head === 'link' ? {text: each.link, kind: `word ${LINKS[each.link]}`} : each[head]),
    })));
  }

  showOntology(message) {
    setText($('ontology-fault'), message.fault ? `The ontology is not up to date: ${message.fault}` : '');
    this.sorts.update(message.sorts.map((each) => ({
      key: each.name,
      cells: [
        each.text, each.parents.join(', '),
        each.objects.join(', ') + (each.count > each.objects.length ? `, … (${each.count})` : ''),
      ],
    })));
    this.features.update(message.features.map((each) => ({
      key: each.name,
      cells: [
        each.text, each.parents.join(', '),
        {text: each.streams.join('\n') || (each.is_provided ? '' : 'no stream'), kind: each.is_provided ? 'lines' : 'warned'},
      ],
    })));
    this.annotations.update(message.annotations.map((each) => ({
      key: each.text, cells: [{text: each.text, kind: 'code'}, {text: each.fault, kind: 'warned'}],
    })));
  }
}
