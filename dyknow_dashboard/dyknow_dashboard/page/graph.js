'use strict';
// The graph from topics over streams and states to formulas, in layers from left to right.

const SVG = 'http://www.w3.org/2000/svg';
const BOX = {width: 190, height: 30, across: 64, down: 12, head: 26};
const MAX_LABEL = 25;

function svg(tag, attributes, ...children) {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

// Orders the nodes of each layer by the mean place of their neighbours, which untangles the edges.
function layered(graph) {
  const layers = graph.layers.map((_, number) => graph.nodes.filter((each) => each.layer === number));
  const neighbours = new Map(graph.nodes.map((each) => [each.id, []]));
  for (const [from, to] of graph.edges) {
    neighbours.get(from).push(to);
    neighbours.get(to).push(from);
  }
  const place = new Map();
  const number = () => layers.forEach((layer) => layer.forEach((each, row) => place.set(each.id, row / layer.length)));
  number();
  for (let pass = 0; pass < 6; pass += 1) {
    for (const layer of layers) {
      const mean = (node) => {
        const near = neighbours.get(node.id);
        return near.length ? near.reduce((sum, id) => sum + place.get(id), 0) / near.length : place.get(node.id);
      };
      const means = new Map(layer.map((each) => [each.id, mean(each)]));
      layer.sort((a, b) => means.get(a.id) - means.get(b.id));
    }
    number();
  }
  return layers;
}

// Everything that a node depends on, and everything that depends on it.
function connected(id, edges) {
  const reach = (start, from, to) => {
    const found = new Set([start]);
    const pending = [start];
    while (pending.length) {
      const node = pending.pop();
      for (const edge of edges) {
        if (edge[from] === node && !found.has(edge[to])) {
          found.add(edge[to]);
          pending.push(edge[to]);
        }
      }
    }
    return found;
  };
  return new Set([...reach(id, 0, 1), ...reach(id, 1, 0)]);
}

class Graph {
  constructor(place) {
    this.place = place;
    this.selected = null;
  }

  show(graph) {
    const text = JSON.stringify(graph);
    if (text === this.text) return;
    this.text = text;
    this.graph = graph;
    const layers = layered(graph);
    const rows = Math.max(1, ...layers.map((each) => each.length));
    const width = layers.length * BOX.width + (layers.length - 1) * BOX.across + 4;
    const height = BOX.head + rows * (BOX.height + BOX.down);
    const places = new Map();
    layers.forEach((layer, column) => layer.forEach((node, row) => {
      const free = (rows - layer.length) / 2;
      places.set(node.id, [2 + column * (BOX.width + BOX.across), BOX.head + (row + free) * (BOX.height + BOX.down)]);
    }));
    const heads = graph.layers.map((name, column) => svg('text',
      {x: 2 + column * (BOX.width + BOX.across), y: 14, class: 'layer'}, name === 'states' ? name : `${name}s`));
    this.edges = graph.edges.map(([from, to]) => this.edge(from, to, places));
    this.nodes = layers.flat().map((node) => this.node(node, places.get(node.id)));
    const picture = svg('svg', {viewBox: `0 0 ${width} ${height}`, width, height},
      ...heads, ...this.edges.map((each) => each.element), ...this.nodes.map((each) => each.element));
    const focused = document.activeElement?.dataset?.node;
    const hidden = graph.hidden ? [make('p', {class: 'soft'}, `${graph.hidden} more are not shown`)] : [];
    this.place.replaceChildren(...(graph.nodes.length ? [picture] : [make('p', {class: 'soft'}, 'There is no stream and no formula.')]), ...hidden);
    if (focused) this.nodes.find((each) => each.id === focused)?.element.focus();
    this.highlight();
  }

  edge(from, to, places) {
    const [x1, y1] = places.get(from);
    const [x2, y2] = places.get(to);
    const start = [x1 + BOX.width, y1 + BOX.height / 2];
    const end = [x2, y2 + BOX.height / 2];
    // Streams that are made of others are in one column: their edges leave and enter at the left.
    const path = x1 === x2
      ? `M${x1},${start[1]} C${x1 - 34},${start[1]} ${x1 - 34},${end[1]} ${x2},${end[1]}`
      : `M${start} C${start[0] + BOX.across / 2},${start[1]} ${end[0] - BOX.across / 2},${end[1]} ${end}`;
    return {from, to, element: svg('path', {d: path, class: 'edge'})};
  }

  node(node, [x, y]) {
    const label = node.name.length > MAX_LABEL ? `${node.name.slice(0, MAX_LABEL - 1)}…` : node.name;
    const title = node.state ? `${node.name}: ${node.state}` : node.name;
    const element = svg('g', {class: `box ${node.state}`, tabindex: 0, role: 'button', 'aria-label': title, 'data-node': node.id},
      svg('title', {}, title),
      svg('rect', {x, y, width: BOX.width, height: BOX.height, rx: 5}),
      svg('text', {x: x + 9, y: y + 20}, label));
    const select = () => {
      this.selected = this.selected === node.id ? null : node.id;
      this.highlight();
    };
    element.addEventListener('click', select);
    element.addEventListener('keydown', (event) => {
      if (event.key === 'Enter' || event.key === ' ') {
        event.preventDefault();
        select();
      } else if (event.key === 'Escape') {
        this.selected = null;
        this.highlight();
      }
    });
    return {id: node.id, element};
  }

  highlight() {
    const near = this.selected ? connected(this.selected, this.graph.edges) : null;
    for (const node of this.nodes) {
      node.element.classList.toggle('faint', near !== null && !near.has(node.id));
      node.element.setAttribute('aria-pressed', String(node.id === this.selected));
    }
    for (const edge of this.edges) {
      edge.element.classList.toggle('faint', near !== null && !(near.has(edge.from) && near.has(edge.to)));
    }
  }
}
