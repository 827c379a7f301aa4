// What must hold of a page so that everybody can use it, as far as the document tells (WCAG 2.2 AA). Returns a list of
// complaints. Names and roles, which the browser computes, are checked from its accessibility tree by the caller.
const complaints = [];
const say = (element, text) => complaints.push(`${pathOf(element)}: ${text}`);
const pathOf = (element) => {
  const own = element.id ? `#${element.id}` : element.className ? `.${String(element.className).split(' ')[0]}` : '';
  const parent = element.parentElement && !element.id ? `${pathOf(element.parentElement)} > ` : '';
  return `${parent}${element.localName}${own}`;
};
const all = (selector) => [...document.querySelectorAll(selector)];
const isShown = (element) => element.checkVisibility({ opacityProperty: true, visibilityProperty: true });

// Structure
const one = (selector, count) => count !== 1 && complaints.push(`${count} of ${selector}, must be 1`);
if (!document.documentElement.lang) complaints.push('the document has no language');
if (!document.title.trim()) complaints.push('the document has no title');
one('main', all('main').length);
one('h1', all('h1').length);
let level = 0;
for (const heading of all('h1,h2,h3,h4,h5,h6').filter(isShown)) {
  const next = Number(heading.localName[1]);
  if (next > level + 1) say(heading, `follows a heading of level ${level}`);
  level = next;
}
for (const list of all('ul,ol')) {
  for (const child of list.children) if (!['LI', 'TEMPLATE'].includes(child.nodeName)) say(child, 'is no item of its list');
}
for (const table of all('table')) {
  if (!table.caption) say(table, 'has no caption');
  for (const cell of table.querySelectorAll('th')) if (!cell.scope) say(cell, 'has no scope');
}
for (const image of all('img:not([alt])')) say(image, 'has no alternative text');
for (const element of all('[tabindex]')) if (element.tabIndex > 0) say(element, 'changes the order of focus');

// References
const seen = new Set();
for (const { id } of all('[id]')) {
  if (seen.has(id)) complaints.push(`the id ${id} is there twice`);
  seen.add(id);
}
for (const name of ['for', 'aria-labelledby', 'aria-describedby', 'aria-controls']) {
  for (const element of all(`[${name}]`)) {
    for (const id of element.getAttribute(name).split(/\s+/)) if (!seen.has(id)) say(element, `${name} names ${id}, which is not there`);
  }
}

// Reach
if (document.documentElement.scrollWidth > innerWidth) complaints.push('the page scrolls sideways');
for (const element of all('main *, main').filter(isShown)) {
  const style = getComputedStyle(element);
  const scrolls = (axis, inner, outer) => /auto|scroll/.test(style[axis]) && inner > outer + 1;
  const canScroll = scrolls('overflowY', element.scrollHeight, element.clientHeight) || scrolls('overflowX', element.scrollWidth, element.clientWidth);
  const isReached = element.tabIndex >= 0 || element.querySelector('a[href],button,input,select,textarea,[tabindex="0"]');
  if (canScroll && !isReached) say(element, 'scrolls, but not from the keyboard');
}
const LEAST_TARGET_PX = 24;
for (const control of all('button,select,textarea,input:not([type=checkbox],[type=radio],[type=file],[type=hidden]),.button').filter(isShown)) {
  const { width, height } = control.getBoundingClientRect();
  if (width < LEAST_TARGET_PX || height < LEAST_TARGET_PX) say(control, `is ${width} by ${height} px, too small to hit`);
}

// Contrast of text with what is behind it (relative luminance and ratio as in WCAG 2.2)
const channels = (color) => {
  const [r, g, b, a = 1] = color.match(/[\d.]+/g).map(Number);
  return [r / 255, g / 255, b / 255, a];
};
const over = (front, back) => [0, 1, 2].map((i) => front[i] * front[3] + back[i] * (1 - front[3])).concat(1);
const luminance = ([r, g, b]) => {
  const linear = (c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
  return 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
};
const behind = (element) => {
  if (!element) return [1, 1, 1, 1];
  const own = channels(getComputedStyle(element).backgroundColor);
  return own[3] === 1 ? own : over(own, behind(element.parentElement));
};
const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
while (walker.nextNode()) {
  const element = walker.currentNode.parentElement;
  const isText = walker.currentNode.data.trim() && !['SCRIPT', 'STYLE', 'TEMPLATE', 'NOSCRIPT', 'OPTION'].includes(element.nodeName);
  if (!isText || !isShown(element) || element.closest('.visually-hidden,:disabled,[aria-busy=true]')) continue;
  const style = getComputedStyle(element);
  const back = behind(element);
  const [high, low] = [luminance(over(channels(style.color), back)), luminance(back)].sort((a, b) => b - a);
  const ratio = (high + 0.05) / (low + 0.05);
  const size = parseFloat(style.fontSize);
  const isLarge = size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 700);
  const least = isLarge ? 3 : 4.5;
  if (ratio < least) say(element, `"${walker.currentNode.data.trim().slice(0, 30)}" has a contrast of ${ratio.toFixed(2)}, must be ${least}`);
}
return complaints;
