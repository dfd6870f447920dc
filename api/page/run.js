// One run: what came out, how it was computed, its drawing, and its replay.

import { getBlob, getJson } from "./api.js";
import { h, put } from "./dom.js";
import { date, duration, labels, number, words } from "./format.js";
import { badge, card, download, facts, heading, listing, note, trouble } from "./frame.js";
import { replayer } from "./replay.js";

function metricsTable(job) {
  const rows = Object.entries(job.metrics).map(([name, value]) => [
    words(name),
    number(value, Number.isInteger(value) ? 0 : Math.abs(value) >= 100 ? 1 : 3),
  ]);
  return listing("Metrics of this run", ["Metric", "#Value"], rows);
}

function attemptsTable(job) {
  const took = (attempt) =>
    attempt.ended_ms === null ? "\u2013" : duration((attempt.ended_ms - attempt.claimed_ms) / 1000);
  return listing(
    "Attempts",
    ["No.", "Worker", "Since", "#Took", "End", "Why"],
    job.attempts.map((attempt) => [
      String(attempt.attempt),
      h("code", {}, attempt.worker.slice(0, 8)),
      date(attempt.claimed_ms),
      took(attempt),
      attempt.end,
      attempt.reason ?? "",
    ]),
  );
}

/** The drawing, asked for when it comes into sight: it takes the server a run. */
function drawing(job, signal) {
  const place = h("div", { class: "drawing" }, note("Drawing ..."));
  getBlob(`/v1/jobs/${job.id}/trajectory.svg`, signal)
    .then((blob) => {
      const url = URL.createObjectURL(blob);
      signal.addEventListener("abort", () => URL.revokeObjectURL(url));
      put(
        place,
        h("img", { src: url, alt: `Path of the run through the field, seen from above; it ended ${job.outcome}` }),
      );
    })
    .catch((error) => signal.aborted || put(place, trouble(error)));
  return place;
}

export async function showRun(main, { id, signal }) {
  const job = await getJson(`/v1/jobs/${id}`, signal);
  const cell = job.cells.at(-1);
  const trail = cell
    ? [
        ["Sweeps", "#/"],
        [`Sweep ${cell.sweep}`, `#/sweeps/${cell.sweep}`],
        [labels(cell.factors), `#/sweeps/${cell.sweep}/cell?${new URLSearchParams(cell.factors)}`],
      ]
    : [["Sweeps", "#/"]];
  const finished = job.digest !== null;
  const told = facts([
    ["Seed", String(job.seed)],
    ["Cell", cell ? labels(cell.factors) : "\u2013"],
    ["Ended", date(job.ended_ms)],
    finished && ["Digest", h("code", { title: job.digest }, job.digest.slice(0, 16))],
    ["Key", h("code", { title: job.key }, job.key.slice(0, 16))],
    job.verification && ["Computed again", job.verification.state],
    job.incidents.length > 0 && ["Incidents", String(job.incidents.length)],
  ]);
  const replay = finished
    ? h("section", { class: "card", id: "replay" }, h("h2", {}, "Replay"), note("Running it again from its seed ..."))
    : null;
  put(
    main,
    heading(`Run ${job.id}`, trail, badge(job.outcome ?? job.state)),
    h("section", { class: "card" }, told),
    replay,
    h(
      "div",
      { class: "two" },
      finished && card("Metrics", metricsTable(job)),
      h(
        "div",
        { class: "column" },
        card("Attempts", attemptsTable(job)),
        finished &&
          card(
            "Drawing",
            drawing(job, signal),
            h(
              "div",
              { class: "links" },
              h("span", { class: "muted" }, "The path as"),
              download("SVG", `/v1/jobs/${job.id}/trajectory.svg`, `run-${job.id}.svg`),
              download("CSV", `/v1/jobs/${job.id}/trajectory?format=csv`, `run-${job.id}.csv`),
              job.scenario.localization.kind === "pose-graph" &&
                download("Pose graph", `/v1/jobs/${job.id}/pose-graph.svg`, `pose-graph-${job.id}.svg`),
            ),
          ),
      ),
    ),
    h(
      "section",
      { class: "card" },
      h(
        "details",
        {},
        h("summary", {}, "Scenario, with all defaults filled in"),
        h("pre", { tabindex: "0" }, JSON.stringify(job.scenario, null, 2)),
      ),
    ),
  );
  if (!replay) return;
  try {
    const seen = await getJson(`/v1/jobs/${id}/replay`, signal);
    const all = h(
      "div",
      { class: "links" },
      h("span", { class: "muted" }, "All scans as"),
      download("MCAP", `/v1/jobs/${id}/replay?format=mcap`, `run-${id}.mcap`),
    );
    put(replay, h("h2", {}, "Replay"), replayer(seen, signal), all);
  } catch (error) {
    if (!signal.aborted) put(replay, h("h2", {}, "Replay"), trouble(error));
  }
}
