// Who works, and what went wrong with results.

import { getJson } from "./api.js";
import { h, put } from "./dom.js";
import { listen } from "./events.js";
import { count, date, duration, rate } from "./format.js";
import { badge, card, facts, heading, listing, note } from "./frame.js";

const REFRESH_MS = 2_000;

function workersTable(workers) {
  if (workers.length === 0) return note("No worker was ever here. Start one: ", h("code", {}, "furrow work"));
  const ago = (ms) => `${duration(Math.max(0, (Date.now() - ms) / 1000))} ago`;
  return listing(
    "Workers",
    ["Name", "State", "#Threads", "#Holds", "#Results", "#Rate", "Last seen", "Since", "Let in by", "Id"],
    workers.map((worker) => [
      worker.name,
      h("span", {}, badge(worker.state), worker.barred && h("span", { class: "bad" }, ` ${worker.barred.reason}`)),
      count(worker.threads),
      count(worker.leased),
      count(worker.results),
      rate(worker.rate_per_s),
      worker.state === "live" ? "now" : ago(worker.last_seen_ms),
      date(worker.first_seen_ms),
      worker.enrolled_by.replace("-", " "),
      h("code", { title: worker.id }, worker.id.slice(0, 8)),
    ]),
  );
}

function incidentsTable(incidents) {
  if (incidents.length === 0) return note("No result differed from the one on record.");
  return listing(
    "Incidents",
    ["Job", "When", "On record", "The other", "Verdict"],
    incidents.map((incident) => [
      h("a", { href: `#/runs/${incident.job}` }, String(incident.job)),
      date(incident.noted_ms),
      h("code", {}, `${incident.recorded_worker.slice(0, 8)} ${incident.recorded_digest.slice(0, 8)}`),
      h("code", {}, `${incident.other_worker.slice(0, 8)} ${incident.other_digest.slice(0, 8)}`),
      incident.verification ?? "not verified",
    ]),
  );
}

export async function showWorkers(main, { signal }) {
  const [working, comparing] = [h("div", {}), h("div", {})];
  async function refresh() {
    const [{ items: workers }, { items: incidents, verified }] = await Promise.all([
      getJson("/v1/workers", signal),
      getJson("/v1/incidents", signal),
    ]);
    put(working, workersTable(workers));
    put(
      comparing,
      facts([
        ["Waiting", count(verified.open)],
        ["Agreed", count(verified.agreed)],
        ["Other was wrong", count(verified.upheld)],
        ["Record was wrong", count(verified.overruled)],
        ["Undecided", count(verified.undecided)],
        ["Given up", count(verified.given_up)],
      ]),
      incidentsTable(incidents),
    );
  }
  await refresh();
  put(main, heading("Workers"), card("", working), card("Results computed again", comparing));
  let timer = null;
  const soon = () => {
    timer ??= setTimeout(() => {
      timer = null;
      refresh().catch(() => {});
    }, REFRESH_MS);
  };
  signal.addEventListener("abort", () => clearTimeout(timer));
  listen(
    "/v1/events",
    {
      workers: (detail) => {
        document.dispatchEvent(new CustomEvent("workforce", { detail }));
        soon();
      },
      incidents: soon,
    },
    signal,
  );
}
