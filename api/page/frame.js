// Pieces that several pages share.

import { ask, hasToken, Problem } from "./api.js";
import { h, s } from "./dom.js";
import { count, duration, percent } from "./format.js";

/** The page's heading, with where it is above it. */
export function heading(text, trail = [], ...beside) {
  document.title = `${text} \u00b7 Furrow`;
  const crumbs =
    trail.length > 0 &&
    h(
      "nav",
      { class: "crumbs", "aria-label": "Above" },
      trail.map(([word, to]) => [h("a", { href: to }, word), h("span", { "aria-hidden": "true" }, "/")]),
    );
  return h("div", { class: "heading" }, crumbs, h("h1", {}, text), beside);
}

export const card = (titleText, ...children) =>
  h("section", { class: "card" }, titleText && h("h2", {}, titleText), children);

export const badge = (state) => h("span", { class: `badge ${state}` }, state);

export const note = (...text) => h("p", { class: "muted" }, text);

/** What went wrong, where it can be seen. */
export function trouble(error) {
  const allowed =
    error instanceof Problem &&
    error.allowed.length > 0 &&
    h("p", {}, `Allowed: ${error.allowed.slice(0, 30).join(", ")}`);
  return h("div", { class: "error", role: "alert" }, h("p", {}, error.message), allowed);
}

/** Names and values. */
export const facts = (entries) =>
  h(
    "dl",
    { class: "facts" },
    entries.filter(Boolean).map(([name, value]) => h("div", {}, h("dt", {}, name), h("dd", {}, value))),
  );

/** A table with a heading for each column; numbers are those whose heading begins with `#`. */
export function listing(caption, columns, rows) {
  const numeric = columns.map((column) => column.startsWith("#"));
  const head = columns.map((column) =>
    h("th", { scope: "col", class: column.startsWith("#") && "number" }, column.replace(/^#/, "")),
  );
  const cell = (value, i) =>
    i === 0
      ? h("th", { scope: "row", class: numeric[0] && "number" }, value)
      : h("td", { class: numeric[i] && "number" }, value);
  return scrolling(
    caption,
    h(
      "table",
      {},
      h("caption", { class: "hidden" }, caption),
      h("thead", {}, h("tr", {}, head)),
      h(
        "tbody",
        {},
        rows.map((row) => h("tr", {}, row.map(cell))),
      ),
    ),
  );
}

/** A wide thing that scrolls by itself, with the keyboard, too. */
export const scrolling = (label, ...children) =>
  h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": label }, children);

/** How far a sweep is, as a bar. */
export function progressBar(sweep) {
  const parts = [
    ["done", sweep.done],
    ["failed", sweep.failed],
    ["leased", sweep.leased],
    ["cancelled", sweep.cancelled],
  ];
  let x = 0;
  const bars = parts.map(([name, n]) => {
    const width = sweep.total > 0 ? (100 * n) / sweep.total : 0;
    const bar = s("rect", { class: name, x: `${x}%`, width: `${width}%`, height: "100%" });
    x += width;
    return bar;
  });
  const now = sweep.done + sweep.failed + sweep.cancelled;
  return h(
    "div",
    {
      class: "bar",
      role: "progressbar",
      "aria-label": `Jobs of ${sweep.name}`,
      "aria-valuemin": "0",
      "aria-valuemax": sweep.total,
      "aria-valuenow": now,
      "aria-valuetext": `${count(now)} of ${count(sweep.total)} jobs`,
    },
    s("svg", { "aria-hidden": "true" }, bars),
  );
}

const share = (sweep) => (sweep.total > 0 ? (sweep.done + sweep.failed + sweep.cancelled) / sweep.total : 1);

/** The time left in words, with its interval. */
export function timeLeft(sweep) {
  if (sweep.state !== "active") return sweep.state;
  if (sweep.eta_s === null) return "no estimate yet";
  const ends = sweep.eta_ci95_s;
  return `${duration(sweep.eta_s)} left${ends ? ` (95 %: ${duration(ends[0])} to ${duration(ends[1])})` : ""}`;
}

/** `12 of 24 jobs, 50 %, 1 failed`. */
export const progressText = (sweep) =>
  `${count(sweep.done)} of ${count(sweep.total)} jobs, ${percent(share(sweep))}${sweep.failed > 0 ? `, ${count(sweep.failed)} failed` : ""}`;

/** A link to a file; with a token it is fetched first, since a link alone sends none. */
export function download(word, path, file) {
  const fetched = async (event) => {
    if (!hasToken()) return;
    event.preventDefault();
    const url = URL.createObjectURL(await (await ask(path)).blob());
    h("a", { href: url, download: file }).click();
    setTimeout(() => URL.revokeObjectURL(url), 60_000);
  };
  return h("a", { class: "button", href: path, download: file, onclick: fetched }, word);
}

/** Buttons of which one is pressed. */
export function choice(label, options, chosen, choose) {
  const group = h("div", { class: "choice", role: "group", "aria-label": label });
  const press = (value) => (event) => {
    for (const button of group.children) button.setAttribute("aria-pressed", String(button === event.currentTarget));
    choose(value);
  };
  group.append(
    ...options.map(([value, word]) =>
      h("button", { type: "button", "aria-pressed": String(value === chosen), onclick: press(value) }, word),
    ),
  );
  return group;
}

/** A labelled list to choose from. */
export function select(label, options, chosen, choose) {
  const list = h(
    "select",
    { onchange: (event) => choose(event.target.value) },
    options.map(([value, word]) => h("option", { value, selected: value === chosen }, word)),
  );
  return h("label", { class: "field" }, h("span", {}, label), list);
}
