// All sweeps, newest first.

import { getJson, withParams } from "./api.js";
import { announce, h, put, redraw } from "./dom.js";
import { listen } from "./events.js";
import { date, rate, several } from "./format.js";
import { badge, heading, note, progressBar, progressText, timeLeft } from "./frame.js";

const PAGE = 50;

function line(sweep) {
  return h(
    "article",
    { class: "sweep" },
    h(
      "div",
      { class: "sweep-name" },
      h("h2", {}, h("a", { href: `#/sweeps/${sweep.id}` }, sweep.name)),
      badge(sweep.state),
    ),
    h(
      "p",
      { class: "muted" },
      `No. ${sweep.id}`,
      sweep.name !== sweep.plan && ` \u00b7 ${sweep.plan}`,
      ` \u00b7 ${date(sweep.created_ms)} \u00b7 ${several(sweep.seeds, "seed")}`,
      sweep.priority !== 0 && ` \u00b7 priority ${sweep.priority}`,
    ),
    progressBar(sweep),
    h(
      "p",
      { class: "sweep-counts" },
      h("span", {}, progressText(sweep)),
      sweep.state === "active" && h("span", { class: "muted" }, `${rate(sweep.rate_per_s)} \u00b7 ${timeLeft(sweep)}`),
    ),
  );
}

export async function showSweeps(main, { query, signal }) {
  const after = query.get("after");
  const { items, next } = await getJson(withParams("/v1/sweeps", { limit: PAGE, after }), signal);
  const [shown, list] = [new Map(items.map((sweep) => [sweep.id, sweep])), h("div", { class: "sweeps" })];
  const draw = () => {
    const newestFirst = [...shown.values()].sort((a, b) => b.id - a.id);
    redraw(
      list,
      newestFirst.length > 0
        ? newestFirst.map(line)
        : h(
            "div",
            { class: "card empty" },
            h("h2", {}, "Nothing has been run here yet"),
            note("A sweep runs every combination of fields, algorithms and seeds of a plan."),
            h("a", { class: "button primary", href: "#/new" }, "Submit the first sweep"),
          ),
    );
  };
  draw();
  put(
    main,
    heading("Sweeps", [], h("a", { class: "button primary", href: "#/new" }, "New sweep")),
    list,
    next !== null && h("p", {}, h("a", { href: `#/?after=${next}` }, "Older sweeps")),
  );
  listen(
    "/v1/events",
    {
      sweeps: ({ items: changed, gone }) => {
        if (after === null) {
          for (const sweep of changed) shown.set(sweep.id, sweep);
          gone.forEach((id) => shown.delete(id));
        } else {
          changed.filter((sweep) => shown.has(sweep.id)).forEach((sweep) => shown.set(sweep.id, sweep));
        }
        draw();
        const active = [...shown.values()].find((sweep) => sweep.state === "active");
        if (active) announce(`Sweep ${active.id}: ${progressText(active)}`);
      },
      workers: (detail) => document.dispatchEvent(new CustomEvent("workforce", { detail })),
    },
    signal,
  );
}
