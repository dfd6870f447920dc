// A sweep: where it stands, what can be done about it, and its results as table, plots, and beside others'.

import { change, getJson } from "./api.js";
import { announce, h, put } from "./dom.js";
import { listen } from "./events.js";
import { count, date, rate } from "./format.js";
import { badge, choice, facts, heading, progressBar, progressText, timeLeft, trouble } from "./frame.js";
import { compareView } from "./compare.js";
import { plotsView } from "./plots.js";
import { publicationView } from "./publication.js";
import { tableView } from "./table.js";

const VIEWS = [
  ["table", "Table", tableView],
  ["plots", "Plots", plotsView],
  ["publication", "Beside the paper", publicationView],
  ["compare", "Compare", compareView],
];
/** Results are fetched this often at most. */
const REFRESH_MS = 1_500;
/** And so many times rarer than they take. */
const REFRESH_SHARE = 5;

function stands(sweep) {
  const engine = h("code", { title: sweep.engine }, sweep.engine.slice(0, 12));
  return [
    progressBar(sweep),
    h(
      "p",
      { class: "sweep-counts" },
      h("span", { id: "progress-text" }, progressText(sweep)),
      h("span", { class: "muted" }, timeLeft(sweep)),
    ),
    facts([
      ["Plan", sweep.plan],
      ["Seeds", count(sweep.seeds)],
      ["Queued", count(sweep.queued)],
      ["Running", count(sweep.leased)],
      ["Rate", sweep.state === "active" ? rate(sweep.rate_per_s) : "\u2013"],
      ["Cached", count(sweep.cached)],
      sweep.disputed > 0 && ["In dispute", count(sweep.disputed)],
      ["Submitted", date(sweep.created_ms)],
      ["Engine", engine],
    ]),
  ];
}

/** Buttons for what may be done about a sweep in its state. */
function controls(sweep, act) {
  const button = (word, kind, does) => h("button", { type: "button", class: kind, onclick: does }, word);
  const path = `/v1/sweeps/${sweep.id}`;
  const live = sweep.state === "active" || sweep.state === "paused";
  const cancel = () =>
    confirm(`Cancel sweep ${sweep.id}? Runs that no other sweep wants are stopped.`) && act("DELETE", path);
  const priority = h("input", {
    type: "number",
    step: "1",
    value: sweep.priority,
    onchange: (event) => act("PATCH", path, { priority: Number(event.target.value) }),
  });
  return h(
    "div",
    { class: "controls" },
    sweep.state === "active" && button("Pause", "", () => act("PATCH", path, { paused: true })),
    sweep.state === "paused" && button("Resume", "primary", () => act("PATCH", path, { paused: false })),
    (sweep.failed > 0 || sweep.cancelled > 0) && button("Retry what failed", "", () => act("POST", `${path}/retry`)),
    live && button("Cancel", "danger", cancel),
    live && h("label", { class: "inline" }, h("span", {}, "Priority"), priority),
  );
}

export async function showSweep(main, { id, query, path, signal }) {
  let sweep = await getJson(`/v1/sweeps/${id}`, signal);
  const [standing, steering, failure, body] = [h("div", {}), h("div", {}), h("div", {}), h("div", { id: "view" })];
  const state = h("span", {});
  const act = async (method, where, what) => {
    put(failure);
    try {
      const ended = sweep.state === "done" || sweep.state === "cancelled";
      update({ ...sweep, ...(await change(method, where, what)) }, true);
      // Its stream of events has ended, too: the page begins anew.
      if (ended) dispatchEvent(new Event("hashchange"));
    } catch (error) {
      put(failure, trouble(error));
    }
  };
  const update = (next, always = false) => {
    const other = next.state !== sweep.state;
    sweep = next;
    put(state, badge(sweep.state));
    put(standing, stands(sweep));
    if (!steering.contains(document.activeElement) || other || always) put(steering, controls(sweep, act));
    announce(`${progressText(sweep)}, ${sweep.state}`, other);
  };
  update(sweep, true);

  const keep = (changes) => {
    for (const [name, value] of Object.entries(changes)) value ? query.set(name, value) : query.delete(name);
    history.replaceState(null, "", `#${path}?${query}`);
  };
  let [view, showing, wanted, busy, timer] = [null, new AbortController(), false, false, null];
  const failed = (error) => signal.aborted || error.name === "AbortError" || put(failure, trouble(error));
  const showView = async (name) => {
    showing.abort();
    [showing, view] = [new AbortController(), null];
    signal.addEventListener("abort", () => showing.abort(), { signal: showing.signal });
    put(failure);
    const [own, build] = [showing.signal, VIEWS.find(([known]) => known === name)[2]];
    try {
      const built = await build(body, { sweep: () => sweep, query, keep, signal: own });
      if (!own.aborted) view = built;
    } catch (error) {
      failed(error);
    }
  };
  const chosen = VIEWS.find(([name]) => name === query.get("view"))?.[0] ?? "table";
  const views = choice(
    "What to show",
    VIEWS.map(([name, word]) => [name, word]),
    chosen,
    (name) => {
      keep({ view: name === "table" ? "" : name });
      showView(name);
    },
  );
  put(
    main,
    heading(sweep.name, [["Sweeps", "#/"]], state),
    h("section", { class: "card" }, standing, steering, failure),
    views,
    body,
  );
  await showView(chosen);

  const pause = (ms) =>
    new Promise((resolve) => {
      timer = setTimeout(resolve, ms);
    });
  /** Now, or when the pause after the last time is over. */
  const refresh = async () => {
    wanted = true;
    if (busy) return;
    busy = true;
    while (wanted && !signal.aborted) {
      wanted = false;
      const begun = Date.now();
      await Promise.resolve(view?.refresh?.()).catch(failed);
      await pause(Math.max(REFRESH_MS, REFRESH_SHARE * (Date.now() - begun)));
    }
    busy = false;
  };
  signal.addEventListener("abort", () => clearTimeout(timer));
  listen(
    `/v1/sweeps/${id}/events`,
    {
      progress: (next) => update(next),
      cells: refresh,
      workers: (detail) => document.dispatchEvent(new CustomEvent("workforce", { detail })),
      end: async () => {
        update(await getJson(`/v1/sweeps/${id}`, signal));
        refresh();
      },
    },
    signal,
  );
}
