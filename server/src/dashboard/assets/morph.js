// Turns one element into another by changing as little as possible, so that focus, scroll positions, open details and
// loaded pictures survive a refresh.
import { swap } from './images.js';

// Attributes that belong to the reader or to the script, not to the server.
const KEPT = new Set(['open', 'data-next', 'style']);

export function morph(from, to) {
  if (from.isEqualNode(to)) return;
  syncAttributes(from, to);
  syncChildren(from, to);
}

function syncAttributes(from, to) {
  for (const { name, value } of to.attributes) {
    if (KEPT.has(name) || from.getAttribute(name) === value) continue;
    if (name === 'src' && from instanceof HTMLImageElement) swap(from, value);
    else if (name === 'class' && from.classList.contains('missing')) from.className = `${value} missing`;
    else from.setAttribute(name, value);
  }
  for (const { name } of [...from.attributes]) {
    const own = name === 'class' && from.classList.contains('missing');
    if (!KEPT.has(name) && !own && !to.hasAttribute(name)) from.removeAttribute(name);
  }
  if (from instanceof HTMLProgressElement) from.value = to.value;
}

// Children with an id are matched by it, the others by their order.
function syncChildren(from, to) {
  const named = new Map();
  for (const child of from.children) if (child.id) named.set(child.id, child);
  let current = from.firstChild;
  for (const wanted of [...to.childNodes]) {
    const known = wanted.id ? named.get(wanted.id) : undefined;
    if (known && sameKind(known, wanted)) {
      if (known === current) current = current.nextSibling;
      else from.insertBefore(known, current);
      morph(known, wanted);
    } else if (current && !current.id && !wanted.id && sameKind(current, wanted)) {
      const next = current.nextSibling;
      if (current.nodeType === Node.ELEMENT_NODE) morph(current, wanted);
      else if (current.data !== wanted.data) current.data = wanted.data;
      current = next;
    } else {
      from.insertBefore(document.importNode(wanted, true), current);
    }
  }
  while (current) {
    const next = current.nextSibling;
    current.remove();
    current = next;
  }
}

function sameKind(a, b) {
  return a.nodeType === b.nodeType && a.nodeName === b.nodeName;
}
