// A sweep's results as plots.

import { getJson, withParams } from "./api.js";
import { MOST_ROWS, figure, heatMap, scatter, strips } from "./charts.js";
import { h, put, redraw } from "./dom.js";
import { count, title } from "./format.js";
import { note, scrolling, select, trouble } from "./frame.js";
import { firstOf, metricsOf, varying } from "./table.js";

export async function plotsView(body, { sweep, query, keep, signal }) {
  const { id, factors } = sweep();
  const [choosing, result] = [h("div", { class: "choosing" }), h("div", { class: "cards" })];
  put(body, h("section", { class: "card" }, choosing), result);
  let [metrics, drawn] = [[], new AbortController()];
  signal.addEventListener("abort", () => drawn.abort());

  const chosen = () =>
    metrics.find(({ name }) => name === query.get("plot")) ??
    metrics.find(({ name }) => name === firstOf(metrics).find((first) => first !== "success")) ??
    metrics[0];

  const drawChoice = () => {
    const words = metrics.map((metric) => [metric.name, title(metric)]);
    const choose = (value) => {
      keep({ plot: value });
      refresh();
    };
    put(choosing, select("Metric", words, chosen().name, choose));
  };

  async function refresh() {
    if (metrics.length === 0) {
      metrics = await metricsOf(sweep(), signal);
      if (metrics.length === 0) return;
      drawChoice();
    }
    drawn.abort();
    drawn = new AbortController();
    const metric = chosen();
    const success = metrics.find(({ name }) => name === "success");
    const names = [...new Set([metric.name, success?.name].filter(Boolean))].join(",");
    const path = withParams(`/v1/sweeps/${id}/table`, { metric: names, statistic: "mean,ci95" });
    const table = await getJson(path, signal);
    const [first, second] = varying(factors, table.cells);
    const pair = second === "field" ? [first, second] : [second, first];
    const cards = [
      h("section", { class: "card" }, h("h2", {}, "Single runs"), await distribution(metric)),
      second && (await heatCard(metric, pair)),
      success && metric !== success && errorCard(table.cells, success, metric, first ?? factors[0]),
    ];
    redraw(result, ...cards);
  }

  async function distribution(metric) {
    if (metric.of_sums)
      return note("This is a ratio of sums over the runs of a cell: single runs have no value of it.");
    try {
      const { cells } = await getJson(withParams(`/v1/sweeps/${id}/values`, { metric: metric.name }), signal);
      return [
        figure((width) => strips(cells, metric, width), drawn.signal),
        note(
          "A dot for each run, hollow where it did not succeed; the box holds the middle half, the line is the median.",
          cells.length > MOST_ROWS && ` The first ${count(MOST_ROWS)} cells are shown.`,
        ),
      ];
    } catch (error) {
      if (signal.aborted) throw error;
      return trouble(error);
    }
  }

  async function heatCard(metric, pair) {
    const by = { metric: metric.name, group_by: pair.join(","), statistic: "mean" };
    const { cells } = await getJson(withParams(`/v1/sweeps/${id}/table`, by), signal);
    return h(
      "section",
      { class: "card" },
      h("h2", {}, `${pair[0]} \u00d7 ${pair[1]}`),
      scrolling(`${pair[0]} by ${pair[1]}`, heatMap(cells, metric, pair)),
      note(`Means of ${title(metric)}: the more, the stronger the colour.`),
    );
  }

  function errorCard(cells, success, metric, colourBy) {
    return h(
      "section",
      { class: "card" },
      h("h2", {}, "Error against success"),
      figure((width) => scatter(cells, [success, metric], colourBy, width), drawn.signal),
      note("A dot for each cell; lines are 95 % intervals."),
    );
  }

  await refresh();
  return { refresh };
}
