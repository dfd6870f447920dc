// Elements from descriptions. Text is always text: nothing that a server says becomes markup.

const SVG = "http://www.w3.org/2000/svg";

function fill(element, properties, children) {
  for (const [name, value] of Object.entries(properties ?? {})) {
    if (value === undefined || value === null || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "value") element.value = value;
    else element.setAttribute(name, value === true ? "" : value);
  }
  element.append(
    ...children.flat(Infinity).filter((child) => child !== undefined && child !== null && child !== false),
  );
  return element;
}

/** An HTML element. */
export const h = (tag, properties, ...children) => fill(document.createElement(tag), properties, children);

/** An SVG element. */
export const s = (tag, properties, ...children) => fill(document.createElementNS(SVG, tag), properties, children);

/** Puts `children` in place of what is in `element`. */
export function put(element, ...children) {
  element.replaceChildren(...children.flat(Infinity).filter(Boolean));
  return element;
}

/** The same for what is drawn again and again: a link keeps the focus, and what was scrolled stays so. */
export function redraw(element, ...children) {
  const focused = element.contains(document.activeElement) ? document.activeElement.getAttribute("href") : null;
  const places = [...element.querySelectorAll(".scroll")].map((scrolled) => scrolled.scrollLeft);
  put(element, ...children);
  element.querySelectorAll(".scroll").forEach((scrolled, i) => {
    scrolled.scrollLeft = places[i] ?? 0;
  });
  if (focused) element.querySelector(`a[href="${CSS.escape(focused)}"]`)?.focus({ preventScroll: true });
}

let spoken = 0;

/** Has a screen reader say `text`, once in a while. */
export function announce(text, always = false) {
  const now = Date.now();
  if (!always && now - spoken < 10_000) return;
  spoken = now;
  document.getElementById("announcer").textContent = text;
}

let ids = 0;

/** An id that no other element has. */
export const uniqueId = (word) => `${word}-${++ids}`;
