'use strict';
// A document that keeps texts only.

const elements = new Map();

class Element {
  constructor(tag) {
    Object.assign(this, {tag, textContent: '', className: '', value: '', hidden: false, children: [], handlers: {}, attributes: {}});
  }
  addEventListener(name, handler) { this.handlers[name] = handler; }
  setAttribute(name, value) { this.attributes[name] = value; }
  append(...children) { this.children.push(...children); }
  replaceChildren(...children) { this.children = children; }
  insertBefore(child, before) {
    const others = this.children.filter((each) => each !== child);
    const place = before ? others.indexOf(before) : others.length;
    this.children = [...others.slice(0, place), child, ...others.slice(place)];
    child.parent = this;
  }
  remove() { this.parent.children = this.parent.children.filter((each) => each !== this); }
  focus() { this.isFocused = true; }
  get firstChild() { return this.children[0] ?? null; }
  get nextSibling() { return this.parent.children[this.parent.children.indexOf(this) + 1] ?? null; }
  get shown() { return this.textContent || this.children.map((each) => each.shown ?? each).filter(Boolean).join(' '); }
}

const document_ = {
  getElementById(id) {
    if (!elements.has(id)) elements.set(id, new Element(id));
    return elements.get(id);
  },
  createElement: (tag) => new Element(tag),
};

module.exports = document_;
