// Two levels of a factor, run by run: paired by the other factors and the seed.

import { getJson, Problem, withParams } from "./api.js";
import { h, put, redraw, s } from "./dom.js";
import { count, interval, labels, number, several, title } from "./format.js";
import { download, facts, listing, note, select, trouble } from "./frame.js";
import { firstOf, metricsOf, varying } from "./table.js";

const TESTS = {
  "mcnemar-exact": "McNemar's exact test",
  "wilcoxon-exact": "Wilcoxon's signed-rank test, exact",
  "wilcoxon-normal": "Wilcoxon's signed-rank test",
};

const probability = (p) => (p === null || p === undefined ? "\u2013" : p < 0.001 ? "< 0.001" : number(p, 3));

/** A difference as a dot on its interval, beside the line at 0. */
function difference(compared, widest) {
  const x = (value) => `${(50 + (47 * value) / widest).toFixed(2)}%`;
  return s(
    "svg",
    { class: "spark difference", "aria-hidden": "true" },
    s("line", { class: "base", x1: "50%", x2: "50%", y1: 0, y2: 10 }),
    compared.ci95
      ? s("line", { class: "interval", x1: x(compared.ci95[0]), x2: x(compared.ci95[1]), y1: 5, y2: 5 })
      : "",
    s("circle", { cx: x(compared.difference), cy: 5, r: 3.5 }),
  );
}

function groupsTable(answer, metric) {
  const groups = answer.groups
    .map((group) => ({ ...group, compared: group.metrics[metric.name] }))
    .filter((group) => group.compared);
  const sizes = groups
    .flatMap(({ compared }) => [compared.difference, ...(compared.ci95 ?? [])])
    .filter(Number.isFinite)
    .map(Math.abs);
  const widest = Math.max(...sizes, Number.MIN_VALUE);
  return listing(
    `${answer.a} beside ${answer.b}`,
    ["Runs", "#Pairs", `#${answer.a}`, `#${answer.b}`, "Difference, with 95 % interval", "#p", "#p after Holm"],
    groups.map(({ factors, compared }) => [
      labels(factors),
      count(compared.n),
      number(compared.a, metric.decimals),
      number(compared.b, metric.decimals),
      h(
        "div",
        { class: "compared" },
        h("b", {}, number(compared.difference, metric.decimals)),
        " ",
        h("span", { class: "muted" }, interval(compared.ci95, metric.decimals)),
        Number.isFinite(compared.difference) && difference(compared, widest),
      ),
      probability(compared.p),
      probability(compared.p_holm),
    ]),
  );
}

/** What is said of all pairs together. */
function summary({ a, b, tests, groups: [all] }, metric) {
  const compared = all.metrics[metric.name];
  const table = compared?.two_by_two;
  const left = [
    [all.incomplete, "incomplete"],
    [all.failed_a + all.failed_b, "with a failed job"],
    [all.ambiguous, "that cannot be told apart"],
  ].filter(([n]) => n > 0);
  return [
    facts([
      ["Pairs", count(all.pairs)],
      ["Seeds", count(all.seeds)],
      compared?.test && ["Test", TESTS[compared.test] ?? compared.test],
      table && ["Both succeed", count(table.both)],
      table && [`Only ${a}`, count(table.only_a)],
      table && [`Only ${b}`, count(table.only_b)],
      table && ["Neither", count(table.neither)],
      compared?.more_seeds > 0 && ["Seeds to go", `about ${count(compared.more_seeds)} a cell`],
      Number.isFinite(compared?.odds_ratio) && ["Odds ratio", number(compared.odds_ratio, 2)],
      Number.isFinite(compared?.d_z) && ["Cohen's d_z", number(compared.d_z, 2)],
      Number.isFinite(compared?.rank_biserial) && ["Rank-biserial", number(compared.rank_biserial, 2)],
    ]),
    left.length > 0 && note(`Left out: ${left.map(([n, why]) => `${count(n)} ${why}`).join(", ")}.`),
    note(
      `Pairs have the same seed and the same labels of all other factors. p after Holm is corrected for ${several(tests, "test")}.`,
    ),
  ];
}

export async function compareView(body, { sweep, query, keep, signal }) {
  const { id, factors } = sweep();
  const [metrics, table] = await Promise.all([
    metricsOf(sweep(), signal),
    getJson(withParams(`/v1/sweeps/${id}/table`, { statistic: "n" }), signal),
  ]);
  const choices = varying(factors, table.cells);
  if (choices.length === 0 || metrics.length === 0) {
    put(
      body,
      h("section", { class: "card" }, note("There is nothing to compare: no factor has two levels with results.")),
    );
    return {};
  }
  const [choosing, result] = [h("div", { class: "choosing" }), h("div", { class: "result" })];
  put(body, h("section", { class: "card" }, choosing, result));
  const asked = () => {
    const factor = choices.includes(query.get("factor")) ? query.get("factor") : choices[0];
    const levels = [...new Set(table.cells.map((cell) => cell.factors[factor]))];
    const [a, b] = ["a", "b"].map((side, i) => (levels.includes(query.get(side)) ? query.get(side) : levels[i]));
    const metric =
      metrics.find((one) => one.name === query.get("of")) ?? metrics.find((one) => one.name === firstOf(metrics)[0]);
    const others = factors.filter((name) => name !== factor);
    return { factor, levels, a, b, metric, others, by: others.includes(query.get("by")) ? query.get("by") : "" };
  };
  const set = (changes) => {
    keep(changes);
    drawChoices();
    refresh();
  };
  const drawChoices = () => {
    const { factor, levels, a, b, metric, others, by } = asked();
    const words = levels.map((level) => [level, level]);
    put(
      choosing,
      select(
        "Factor",
        choices.map((name) => [name, name]),
        factor,
        (value) => set({ factor: value, a: "", b: "" }),
      ),
      select("A", words, a, (value) => set({ a: value })),
      select("B", words, b, (value) => set({ b: value })),
      select(
        "Metric",
        metrics.map((one) => [one.name, title(one)]),
        metric.name,
        (value) => set({ of: value }),
      ),
      others.length > 0 &&
        select("Also by", [["", "nothing"], ...others.map((name) => [name, name])], by, (value) => set({ by: value })),
    );
  };
  async function refresh() {
    const { factor, a, b, metric, by } = asked();
    const path = (format) =>
      withParams(`/v1/sweeps/${id}/compare`, { factor, a, b, metric: metric.name, group_by: by || undefined, format });
    try {
      const answer = await getJson(path(), signal);
      redraw(
        result,
        groupsTable(answer, metric),
        summary(answer, metric),
        h(
          "div",
          { class: "links" },
          h("span", { class: "muted" }, "This as"),
          download("CSV", path("csv"), `compare-${id}.csv`),
          download("Markdown", path("md"), `compare-${id}.md`),
          download("LaTeX", path("latex"), `compare-${id}.tex`),
        ),
      );
    } catch (error) {
      if (signal.aborted) throw error;
      redraw(
        result,
        error instanceof Problem && error.status === 404
          ? note("This server does not compare runs in pairs.")
          : trouble(error),
      );
    }
  }
  drawChoices();
  await refresh();
  return { refresh };
}
