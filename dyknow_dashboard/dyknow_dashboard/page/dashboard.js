'use strict';
// The page: its parts, and the connection to the server.

const VIEWS = ['formulas', 'history', 'streams', 'graph', 'nodes', 'ontology'];
const MAX_RETRY_MS = 5000;
const TAB_KEYS = {ArrowRight: 1, ArrowLeft: -1};

const list = new FormulaList($('list'), $('earlier-list'), () => sendInterest());
const tables = new Tables();
const graphView = new Graph($('graph-view'));
const askForm = new AskForm();
const alarms = new Alarms();
const kept = new KeptFailures();
let socket = null;
let retry = 500;
let view = 'formulas';

const HANDLERS = {
  hello(message) {
    list.readOnly = message.read_only;
    kept.readOnly = message.read_only;
    $('history-actions').hidden = message.read_only;
    $('asking').hidden = message.read_only;
  },
  formulas(message) {
    list.canSave = message.can_save;
    list.update(message.rows);
    const {failing, running, ended, earlier} = message.counts;
    document.title = failing ? `(${failing}) DyKnow` : 'DyKnow';
    $('earlier').hidden = !earlier;
    setText($('earlier-count'), `${earlier}`);
    $('save-all').hidden = !message.can_save || list.readOnly;
    $('empty').hidden = Boolean(message.rows.length);
    setText($('count'), `${failing} failing, ${running} running, ${ended} ended${message.hidden ? `, ${message.hidden} more are not shown` : ''}`);
    alarms.update(message.rows);
  },
  history: (message) => kept.update(message),
  details: (message) => list.get(message.id)?.details(message),
  map: (message) => list.get(message.id)?.drawMap(message.image),
  drawing: (message) => list.get(message.id)?.draw(message),
  points: (message) => list.get(message.id)?.extend(message),
  streams: (message) => tables.showStreams(message),
  nodes: (message) => tables.showNodes(message),
  peers: (message) => tables.showPeers(message),
  ontology: (message) => tables.showOntology(message),
  graph: (message) => graphView.show(message),
};

function sendInterest() {
  if (socket?.readyState !== WebSocket.OPEN) return;
  // A page that nobody sees needs no signals.
  socket.send(JSON.stringify({view, opened: document.hidden ? [] : list.opened}));
}

function connect() {
  const scheme = location.protocol === 'https:' ? 'wss' : 'ws';
  socket = new WebSocket(`${scheme}://${location.host}/live`);
  socket.addEventListener('open', () => {
    retry = 500;
    setConnected(true, '');
    sendInterest();
  });
  socket.addEventListener('message', (event) => {
    const message = JSON.parse(event.data);
    HANDLERS[message.type]?.(message);
  });
  socket.addEventListener('close', (event) => {
    setConnected(false, event.reason);
    setTimeout(connect, retry);
    retry = Math.min(2 * retry, MAX_RETRY_MS);
  });
}

function setConnected(isConnected, reason) {
  setText($('connection'), isConnected ? 'live' : 'lost');
  setClass($('connection'), `chip ${isConnected ? 'good' : 'bad'}`);
  const lost = $('lost');
  lost.hidden = isConnected;
  const why = reason ? `: ${reason}` : '';
  setText(lost, isConnected ? '' : `The connection to the server is lost${why}. What you see is old. Connecting again…`);
  document.body.classList.toggle('stale', !isConnected);
}

function showView(name, focus) {
  view = name;
  for (const each of VIEWS) {
    const tab = $(`tab-${each}`);
    tab.setAttribute('aria-selected', String(each === name));
    tab.tabIndex = each === name ? 0 : -1;
    $(each).hidden = each !== name;
  }
  if (focus) $(`tab-${name}`).focus();
  if (name === 'history') kept.show(null);
  history.replaceState(null, '', `#${name}`);
  sendInterest();
}

$('tabs').addEventListener('click', (event) => {
  const tab = event.target.closest('[role=tab]');
  if (tab) showView(tab.getAttribute('aria-controls'));
});
$('tabs').addEventListener('keydown', (event) => {
  const step = TAB_KEYS[event.key];
  const number = VIEWS.indexOf(view);
  if (step) showView(VIEWS[(number + step + VIEWS.length) % VIEWS.length], true);
  else if (event.key === 'Home') showView(VIEWS[0], true);
  else if (event.key === 'End') showView(VIEWS.at(-1), true);
});
$('filter').addEventListener('input', () => list.filter($('filter').value));
$('zone').addEventListener('click', () => {
  setZone(!isUtc);
  list.refresh();
  kept.show(kept.before);
});
$('health').addEventListener('click', () => showView('nodes', true));
$('save-all').addEventListener('click', async () => {
  const answer = await request('save', {name: ''});
  setText($('notice'), answer.error ?? `saved: ${answer.paths.join(', ')}`);
});
document.addEventListener('visibilitychange', sendInterest);
addEventListener('hashchange', () => VIEWS.includes(location.hash.slice(1)) && showView(location.hash.slice(1)));

setZone(isUtc);
// On a phone the verdicts come first.
$('asking').open = matchMedia('(min-width: 44rem)').matches;
if (VIEWS.includes(location.hash.slice(1))) showView(location.hash.slice(1));
connect();
