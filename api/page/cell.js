// The runs of a cell, grouped by how they ended.

import { getJson, withParams } from "./api.js";
import { h, put } from "./dom.js";
import { count, labels, number, several, title } from "./format.js";
import { card, facts, heading, listing, note } from "./frame.js";
import { figure, strips } from "./charts.js";
import { firstOf, metricsOf } from "./table.js";

const MOST = 1_000;
/** Failed jobs whose reasons are asked for. */
const REASONS = 20;
const CAUSES = [
  ["interventions_bad_start", "bad start"],
  ["interventions_gap", "gap"],
  ["interventions_perception", "perception"],
  ["interventions_control", "control"],
];

const factorParams = (query) => Object.fromEntries([...query].map(([name, label]) => [`factor.${name}`, label]));

const kind = (job) => (job.state === "done" ? job.outcome : job.state);

/** Successes come last: who opens a cell looks for what went wrong. */
const rank = (word) => ({ failed: 0, success: 3, queued: 4, leased: 4, cancelled: 5 })[word] ?? 1;

function groups(jobs) {
  const found = new Map();
  for (const job of jobs) found.set(kind(job), [...(found.get(kind(job)) ?? []), job]);
  return [...found].sort(([a, one], [b, other]) => rank(a) - rank(b) || other.length - one.length);
}

/** Why jobs were given up on, with how many. */
async function reasons(jobs, signal) {
  const some = await Promise.all(jobs.slice(0, REASONS).map((job) => getJson(`/v1/jobs/${job.id}`, signal)));
  const told = new Map();
  for (const job of some) {
    const last = job.attempts.findLast((attempt) => attempt.reason || attempt.end !== "open");
    const why = last ? `${last.end}${last.reason ? `: ${last.reason}` : ""}` : "unknown";
    told.set(why, (told.get(why) ?? 0) + 1);
  }
  return h(
    "ul",
    { class: "reasons" },
    [...told].map(([why, n]) => h("li", {}, `${several(n, "job")}: `, h("code", {}, why))),
  );
}

function causes(cells) {
  const sum = (name) =>
    cells.flatMap((cell) => cell.metrics[name] ?? []).reduce((total, value) => total + (value ?? 0), 0);
  const told = CAUSES.map(([name, word]) => [word, sum(name)]).filter(([, n]) => n > 0);
  return told.length > 0 && card("Interventions by cause", facts(told.map(([word, n]) => [word, count(n)])));
}

export async function showCell(main, { id, query, signal }) {
  const sweep = await getJson(`/v1/sweeps/${id}`, signal);
  const factors = factorParams(query);
  const [{ items, next }, metrics] = await Promise.all([
    getJson(withParams("/v1/jobs", { sweep: id, limit: MOST, ...factors }), signal),
    metricsOf(sweep, signal),
  ]);
  const ofRuns = metrics.filter((metric) => !metric.of_sums);
  const shown = firstOf(ofRuns).map((name) => ofRuns.find((metric) => metric.name === name));
  const asked = [...new Set([...shown.map((metric) => metric.name), ...CAUSES.map(([name]) => name)])].slice(0, 8);
  const cells =
    items.some((job) => job.state === "done") && sweep.done <= 20_000
      ? (await getJson(withParams(`/v1/sweeps/${id}/values`, { metric: asked.join(","), ...factors }), signal)).cells
      : [];
  const value = (job, metric) => {
    for (const cell of cells) {
      const i = cell.jobs.indexOf(job.id);
      if (i >= 0) return cell.metrics[metric.name]?.[i];
    }
    return null;
  };
  const name = labels(Object.fromEntries(query), sweep.factors);
  const rest = sweep.factors.filter((factor) => !query.has(factor));
  const line = (job) => [
    h("a", { href: `#/runs/${job.id}` }, `seed ${job.seed}`),
    ...rest.map((factor) => job.factors[factor]),
    ...shown.map((metric) => number(value(job, metric), metric.decimals)),
    String(job.attempts),
    h("code", {}, job.key.slice(0, 12)),
  ];
  const parts = await Promise.all(
    groups(items).map(async ([word, jobs]) =>
      h(
        "section",
        { class: "card" },
        h("h2", {}, h("span", { class: `badge ${word}` }, word), ` ${several(jobs.length, "run")}`),
        word === "failed" && (await reasons(jobs, signal)),
        listing(
          `Runs: ${word}`,
          ["Run", ...rest, ...shown.map((metric) => `#${title(metric).replace(" ratio", "")}`), "#Attempts", "Key"],
          jobs.map(line),
        ),
      ),
    ),
  );
  const plotted = shown.find((metric) => metric.name !== "success");
  put(
    main,
    heading(name, [
      ["Sweeps", "#/"],
      [sweep.name, `#/sweeps/${id}`],
    ]),
    plotted &&
      cells.length > 0 &&
      h(
        "section",
        { class: "card" },
        figure((width) => strips(cells, plotted, width), signal),
      ),
    causes(cells),
    parts,
    items.length === 0 && note("This cell has no runs."),
    next !== null && note(`The first ${count(MOST)} runs are shown.`),
  );
}
