// The published tables that a sweep's plan belongs to, beside ours.

import { getJson, withParams } from "./api.js";
import { h, put, redraw } from "./dom.js";
import { interval, labels, number } from "./format.js";
import { card, download, listing, note, select } from "./frame.js";

const WORDS = {
  inside: "inside our interval",
  "same-ranking": "same ranking",
  different: "different",
  "not-run": "not run",
  holds: "holds",
  "does-not-hold": "does not hold",
  undecided: "undecided",
};

const decimals = (cell) => (Math.abs(cell.published ?? cell.ours?.mean ?? 0) >= 100 ? 1 : 2);

/** Text in which the beginnings of keys lead to their runs. */
const linked = (text) =>
  text.split(/\b([0-9a-f]{12})\b/).map((part, i) => (i % 2 === 1 ? h("a", { href: `#/runs/${part}` }, part) : part));

function line(cell) {
  const ours = cell.ours && [
    h("b", {}, number(cell.ours.mean, decimals(cell))),
    " ",
    h("span", { class: "muted" }, interval(cell.ours.ci95, decimals(cell))),
  ];
  return [
    labels(cell.factors),
    ours || "\u2013",
    number(cell.published, decimals(cell)),
    cell.verdict ? h("span", { class: `verdict ${cell.verdict}` }, WORDS[cell.verdict] ?? cell.verdict) : "\u2013",
    number(cell.program, decimals(cell)),
    cell.ours ? String(cell.ours.n) : "0",
    h("div", { class: cell.note && "why" }, linked(cell.note ?? "")),
  ];
}

export async function publicationView(body, { sweep, query, keep, signal }) {
  const { id } = sweep();
  const { items } = await getJson(`/v1/publications?sweep=${id}`, signal);
  if (items.length === 0) {
    put(body, card("Beside the paper", note("This plan belongs to no publication.")));
    return {};
  }
  const name = (item) => `${item.source}/${item.table}`;
  const result = h("div", { class: "result" });
  const chosen = () => items.find((item) => name(item) === query.get("published")) ?? items[0];
  const choose = (value) => {
    keep({ published: value });
    refresh();
  };
  put(
    body,
    h(
      "section",
      { class: "card" },
      h(
        "div",
        { class: "choosing" },
        select(
          "Table",
          items.map((item) => [name(item), `${item.source}, ${item.table}`]),
          name(chosen()),
          choose,
        ),
      ),
      result,
    ),
  );

  async function refresh() {
    const { source, table } = chosen();
    const path = `/v1/publications/${source}/${table}`;
    const comparison = await getJson(withParams(path, { sweep: id }), signal);
    const unit = comparison.unit === "1" ? "" : ` [${comparison.unit}]`;
    const file = (format) => withParams(path, { sweep: id, format });
    const run = comparison.cells.filter((cell) => cell.ours);
    const shown = run.length > 0 && query.get("all") !== "1" ? run : comparison.cells;
    const every = h("input", {
      type: "checkbox",
      checked: query.get("all") === "1",
      onchange: (event) => {
        keep({ all: event.target.checked ? "1" : "" });
        refresh();
      },
    });
    redraw(
      result,
      h("h3", {}, `${comparison.citation}, ${table}: ${comparison.metric.replaceAll("_", " ")}${unit}`),
      comparison.note && note(comparison.note),
      listing(
        `${table} beside ours`,
        ["Cell", "#Ours, mean and 95 %", "#Published", "Verdict", "#Their program", "#Runs", "Why"],
        shown.map(line),
      ),
      run.length > 0 &&
        run.length < comparison.cells.length &&
        h("label", { class: "inline" }, every, "Show what was not run here, too"),
      h(
        "div",
        { class: "links" },
        h("span", { class: "muted" }, "This table as"),
        download("CSV", file("csv"), `${table}.csv`),
        download("Markdown", file("md"), `${table}.md`),
        download("LaTeX", file("latex"), `${table}.tex`),
      ),
    );
  }
  await refresh();
  return { refresh };
}
