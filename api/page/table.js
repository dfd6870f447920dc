// A sweep's results as a table of means with 95 % intervals, in rows and columns by factors.

import { getJson, withParams } from "./api.js";
import { h, put, redraw, s, uniqueId } from "./dom.js";
import { count, interval, number, title } from "./format.js";
import { download, note, scrolling, select } from "./frame.js";
import { scaleOf } from "./scale.js";

/** Shown where the user has not chosen. */
const FIRST = ["success", "mean_squared_error_mm2", "distance_per_intervention_m", "cross_track_rms_m"];
const MOST_FIRST = 2;
const MOST = 6;
/** Further rows are in the files only. */
const MOST_ROWS = 500;

/** A mean as a dot on its interval. */
function bar(statistics, scale) {
  const x = (value) => `${(3 + 94 * Math.min(1, Math.max(0, scale.at(value)))).toFixed(2)}%`;
  const [low, high] = statistics.ci95 ?? [];
  const ends =
    Number.isFinite(low) &&
    s("line", { class: "interval", x1: x(low), x2: Number.isFinite(high) ? x(high) : "100%", y1: 5, y2: 5 });
  return s(
    "svg",
    { class: "spark", "aria-hidden": "true" },
    s("line", { class: "base", x1: "0", x2: "100%", y1: 5, y2: 5 }),
    ends || [],
    s("circle", { cx: x(statistics.mean), cy: 5, r: 3.5 }),
  );
}

/** Factors with more than one label among `cells`. */
export const varying = (factors, cells) =>
  factors.filter((name) => new Set(cells.map((cell) => cell.factors[name])).size > 1);

function entry(cell, metric, scale, to) {
  if (!cell) return h("td", { class: "empty-cell" }, "\u2013");
  const [statistics, success] = [cell.metrics[metric.name], cell.metrics.success];
  const runs = cell.n + (cell.missing ?? 0);
  const unsuccessful = success && success.mean !== null ? Math.round(success.n * (1 - success.mean)) : 0;
  const filling = cell.missing > 0 && h("span", { class: "filling" }, `${count(cell.n)} of ${count(runs)} runs`);
  const ran = filling || h("span", {}, `n = ${count(cell.n)}`);
  const beside = h(
    "span",
    { class: "beside" },
    ran,
    unsuccessful > 0 && h("span", { class: "bad" }, `${count(unsuccessful)} unsuccessful`),
  );
  const defined = statistics && (statistics.mean !== null || statistics.ci95);
  const value = defined
    ? [
        h("span", { class: "mean" }, statistics.mean === null ? "\u221e" : number(statistics.mean, metric.decimals)),
        " ",
        h("span", { class: "range" }, interval(statistics.ci95, metric.decimals)),
        statistics.mean !== null && bar(statistics, scale),
      ]
    : h("span", { class: "muted" }, cell.n === 0 ? "no run yet" : "undefined");
  return h("td", { class: cell.missing > 0 && "unfinished" }, h("a", { class: "cell", href: to(cell) }, value, beside));
}

/** Labels of the rows, and of the columns where a factor makes them, in the order in which they come. */
function pivot(cells, rowFactors, columnFactor) {
  const [rows, columns] = [new Map(), []];
  for (const cell of cells) {
    const key = JSON.stringify(rowFactors.map((name) => cell.factors[name]));
    if (!rows.has(key)) rows.set(key, { labels: rowFactors.map((name) => cell.factors[name]), cells: new Map() });
    const column = columnFactor ? cell.factors[columnFactor] : "";
    rows.get(key).cells.set(column, cell);
    if (!columns.includes(column)) columns.push(column);
  }
  return { rows: [...rows.values()], columns };
}

function grid(table, metrics, rowFactors, columnFactor, to) {
  const { rows, columns } = pivot(table.cells, rowFactors, columnFactor);
  const parts = columnFactor ? metrics.map((metric) => [title(metric), [metric]]) : [["Results", metrics]];
  return parts.map(([caption, shown]) => {
    const scales = new Map(
      shown.map((metric) => [
        metric.name,
        scaleOf(
          metric,
          table.cells.map((cell) => cell.metrics[metric.name] ?? {}),
        ),
      ]),
    );
    const head = columnFactor ? columns : shown.map(title);
    const body = rows
      .slice(0, MOST_ROWS)
      .map((row) =>
        h(
          "tr",
          {},
          rowFactors.length > 0
            ? row.labels.map((label) => h("th", { scope: "row" }, label))
            : h("th", { scope: "row" }, "all runs"),
          columnFactor
            ? columns.map((column) => entry(row.cells.get(column), shown[0], scales.get(shown[0].name), to))
            : shown.map((metric) => entry(row.cells.get(""), metric, scales.get(metric.name), to)),
        ),
      );
    const corner = rowFactors.length > 0 ? rowFactors : [""];
    const logarithmic = shown.filter((metric) => scales.get(metric.name).logarithmic).map((metric) => metric.title);
    return [
      columnFactor && h("h3", {}, caption),
      scrolling(
        caption,
        h(
          "table",
          { class: "results" },
          h("caption", { class: "hidden" }, columnFactor ? `${caption} by ${columnFactor}` : caption),
          h(
            "thead",
            {},
            h(
              "tr",
              {},
              corner.map((name) => h("th", { scope: "col" }, name)),
              head.map((word) => h("th", { scope: "col" }, word)),
            ),
          ),
          h("tbody", {}, body),
        ),
      ),
      rows.length > MOST_ROWS &&
        note(`The first ${count(MOST_ROWS)} of ${count(rows.length)} rows; the files below hold all of them.`),
      logarithmic.length > 0 && note(`Bars of ${logarithmic.join(", ")} are on a logarithmic scale.`),
    ];
  });
}

function metricBoxes(metrics, chosen, choose) {
  const boxes = metrics.map((metric) => {
    const id = uniqueId("metric");
    const box = h("input", {
      type: "checkbox",
      id,
      value: metric.name,
      checked: chosen.includes(metric.name),
      onchange: () => choose(read()),
    });
    return h("div", { class: "check" }, box, h("label", { for: id }, title(metric)));
  });
  const read = () =>
    boxes
      .map((box) => box.firstChild)
      .filter((box) => box.checked)
      .map((box) => box.value);
  return h("details", { class: "metrics" }, h("summary", {}, "Metrics"), h("div", { class: "checks" }, boxes));
}

/** Which metrics there are, and which are shown where nobody chose. */
export async function metricsOf(sweep, signal) {
  const by = sweep.factors[0] ?? "";
  const { metrics } = await getJson(
    withParams(`/v1/sweeps/${sweep.id}/table`, { group_by: by, statistic: "n" }),
    signal,
  );
  return metrics;
}

export function firstOf(metrics) {
  const [names, known] = [
    metrics.map((metric) => metric.name),
    FIRST.filter((name) => metrics.some((metric) => metric.name === name)),
  ];
  return [...known, ...names].slice(0, Math.min(MOST_FIRST, names.length));
}

/** The view: what to choose above, the table below, which `refresh` fetches again. */
export async function tableView(body, { sweep, query, keep, signal }) {
  const { id, factors } = sweep();
  const [choosing, result, links] = [
    h("div", { class: "choosing" }),
    h("div", { class: "result" }),
    h("div", { class: "links" }),
  ];
  put(body, h("section", { class: "card" }, choosing, result, links));
  let metrics = [];

  const asked = () => {
    const known = metrics.map((metric) => metric.name);
    const chosen = (query.get("metric") ?? "")
      .split(",")
      .filter((name) => known.includes(name))
      .slice(0, MOST);
    const columns = query.has("columns") ? query.get("columns") : "";
    const dropped = (query.get("without") ?? "")
      .split(",")
      .filter((name) => factors.includes(name) && name !== columns);
    return {
      chosen: chosen.length > 0 ? chosen : firstOf(metrics),
      columns: factors.includes(columns) ? columns : "",
      kept: factors.filter((name) => !dropped.includes(name)),
      dropped,
    };
  };
  const params = () => {
    const { chosen, kept } = asked();
    const names = metrics.some((metric) => metric.name === "success") ? [...new Set([...chosen, "success"])] : chosen;
    return {
      group_by: kept.length < factors.length ? kept.join(",") : undefined,
      metric: names.join(","),
      statistic: "mean,ci95",
    };
  };
  const drawChoices = () => {
    const { chosen, columns, kept } = asked();
    const rows = factors
      .filter((name) => name !== columns)
      .map((name) => {
        const box = (event) => {
          const rest = new Set(asked().dropped);
          event.target.checked ? rest.delete(name) : rest.add(name);
          keep({ without: [...rest].join(",") });
          refresh();
        };
        return h(
          "label",
          { class: "inline" },
          h("input", { type: "checkbox", checked: kept.includes(name), onchange: box }),
          name,
        );
      });
    const chooseColumns = (value) => {
      keep({ columns: value });
      drawChoices();
      refresh();
      choosing.querySelector("select").focus();
    };
    const chooseMetrics = (names) => {
      keep({ metric: names.join(",") });
      refresh();
    };
    put(
      choosing,
      select("Columns", [["", "metrics"], ...factors.map((name) => [name, name])], columns, chooseColumns),
      h("fieldset", { class: "plain" }, h("legend", {}, "Rows by"), rows),
      metricBoxes(metrics, chosen, chooseMetrics),
    );
  };
  const drawLinks = () => {
    const columns = asked().columns || undefined;
    const path = (format) => withParams(`/v1/sweeps/${id}/table`, { ...params(), columns, format });
    put(
      links,
      h("span", { class: "muted" }, "This table as"),
      download("CSV", path("csv"), `sweep-${id}.csv`),
      download("Markdown", path("md"), `sweep-${id}.md`),
      download("LaTeX", path("latex"), `sweep-${id}.tex`),
      download("JSON", path("json"), `sweep-${id}.json`),
      h("span", { class: "muted" }, "and the whole sweep as"),
      download("a report", `/v1/sweeps/${id}/report`, `sweep-${id}.html`),
    );
  };
  const to = (cell) => `#/sweeps/${id}/cell?${new URLSearchParams(cell.factors)}`;

  async function refresh() {
    if (metrics.length === 0) {
      metrics = await metricsOf(sweep(), signal);
      if (metrics.length === 0) {
        put(result, h("p", { class: "empty muted" }, "No run has ended yet. The table fills in as they do."));
        return;
      }
      drawChoices();
    }
    const { chosen, columns, kept } = asked();
    const table = await getJson(withParams(`/v1/sweeps/${id}/table`, params()), signal);
    const shown = chosen.map((name) => table.metrics.find((metric) => metric.name === name)).filter(Boolean);
    const filling = table.cells.filter((cell) => cell.missing > 0).length;
    redraw(
      result,
      filling > 0 &&
        note(
          `${count(filling)} of ${count(table.cells.length)} cells are still filling; their means are of the runs so far.`,
        ),
      grid(
        table,
        shown,
        kept.filter((name) => name !== columns),
        columns,
        to,
      ),
      note(
        "Mean and, in brackets, its 95 % interval; the dot on each bar is the mean, the line the interval. A cell leads to its runs.",
      ),
    );
    drawLinks();
  }
  await refresh();
  return { refresh };
}
