// Rows of a form for parameters: chosen by their dotted paths, with all that the server knows of them.

import { h, put, uniqueId } from "./dom.js";

/** The parameters that a plan's scenarios have, by path; those of several kinds keep all their meanings. */
export function parametersOf(plan, choices) {
  const found = new Map();
  for (const choice of choices.filter((one) => plan.kinds[one.part]?.includes(one.kind)))
    for (const parameter of choice.parameters) {
      const known = found.get(parameter.path) ?? [];
      found.set(parameter.path, [...known, { ...parameter, kind: choice.kind }]);
    }
  return found;
}

/** A number, a word or JSON as a person writes it. */
const written = (value) => (typeof value === "string" ? value : JSON.stringify(value));

function allowed({ range, words, unit }) {
  const of = unit && unit !== "1" ? ` ${unit}` : "";
  if (range) return `${range[0]} to ${range[1]}${of}`;
  return words.join(", ");
}

function sentence(parameter) {
  const limits = allowed(parameter);
  return (
    `${parameter.kind}: ${parameter.about} ${parameter.source} Default ${written(parameter.default)}` +
    (limits ? `, allowed ${limits}.` : ".")
  );
}

/** Rows of paths and values under a heading. `known` gives the parameters there are at present. */
export function parameterRows({ word, adds, value, hint }, known, changed) {
  const list = h("datalist", { id: uniqueId("paths") });
  const rows = h("div", { class: "settings" });
  const row = () => {
    const about = h("p", { class: "hint" });
    const path = h("input", {
      type: "text",
      class: "path",
      list: list.id,
      placeholder: "perception.iterations",
      "aria-label": "Path in the scenario",
      autocomplete: "off",
      spellcheck: "false",
    });
    const explain = () => put(about, (known().get(path.value.trim()) ?? []).map(sentence).join(" "));
    path.addEventListener("input", explain);
    const remove = () => {
      one.remove();
      changed();
    };
    const one = h(
      "div",
      { class: `setting ${word}` },
      h(
        "div",
        { class: "row" },
        path,
        h("input", { type: "text", class: "value", placeholder: value, "aria-label": hint, spellcheck: "false" }),
        h(
          "button",
          { type: "button", class: "small", "aria-label": "Remove this parameter", onclick: remove },
          "\u00d7",
        ),
      ),
      about,
      h("p", { class: "error", role: "alert", hidden: true }),
    );
    return one;
  };
  const add = h("button", { type: "button", class: "small", onclick: () => rows.append(row()) }, adds);
  const refresh = () =>
    put(
      list,
      [...known().keys()].sort().map((path) => h("option", { value: path })),
    );
  return { element: h("div", { class: `${word}-rows` }, list, rows, add), refresh };
}

/** JSON where it is, else the text itself. */
export function literal(text) {
  try {
    return JSON.parse(text);
  } catch {
    return text;
  }
}

/** Several: the inside of a JSON array, else whatever stands between commas. */
export function literals(text) {
  try {
    return JSON.parse(`[${text}]`);
  } catch {
    return text.split(",").map((one) => literal(one.trim()));
  }
}

/** What rows of this word say, by path. */
export function readRows(form, word, read) {
  const values = {};
  for (const row of form.querySelectorAll(`.setting.${word}`)) {
    const path = row.querySelector(".path").value.trim();
    if (path) values[path] = read(row.querySelector(".value").value.trim());
  }
  return values;
}
