// Which page is shown: the part of the address behind `#`.

import { h, put } from "./dom.js";
import { rate, several } from "./format.js";
import { heading, trouble } from "./frame.js";
import { showCell } from "./cell.js";
import { showRun } from "./run.js";
import { showSubmit } from "./submit.js";
import { showSweep } from "./sweep.js";
import { showSweeps } from "./sweeps.js";
import { showWorkers } from "./workers.js";

const PAGES = [
  [/^\/?$/, showSweeps, "sweeps"],
  [/^\/sweeps\/(\d+)$/, showSweep, "sweeps"],
  [/^\/sweeps\/(\d+)\/cell$/, showCell, "sweeps"],
  [/^\/runs\/([0-9a-f]+)$/, showRun, "sweeps"],
  [/^\/new$/, showSubmit, "new"],
  [/^\/workers$/, showWorkers, "workers"],
];

const main = document.getElementById("main");
let [leaving, shownPath] = [new AbortController(), null];

async function show() {
  const [path, query = ""] = location.hash.replace(/^#/, "").split("?");
  leaving.abort();
  leaving = new AbortController();
  const { signal } = leaving;
  const page = PAGES.find(([pattern]) => pattern.test(path));
  for (const link of document.querySelectorAll("[data-nav]")) {
    if (link.dataset.nav === page?.[2]) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  if (!page) {
    put(main, heading("There is no such page"), h("p", {}, h("a", { href: "#/" }, "All sweeps")));
    return;
  }
  const moved = shownPath !== null && shownPath !== path;
  if (shownPath !== path) put(main, h("p", { class: "muted" }, "Loading ..."));
  shownPath = path;
  try {
    await page[1](main, { id: page[0].exec(path)[1], query: new URLSearchParams(query), path, signal });
    if (moved && !signal.aborted) {
      main.focus({ preventScroll: true });
      scrollTo(0, 0);
    }
  } catch (error) {
    if (!signal.aborted)
      put(main, heading("This cannot be shown"), trouble(error), h("p", {}, h("a", { href: "#/" }, "All sweeps")));
  }
}

/** Who works now, in the corner, as the last stream of events said. */
function showPulse({ detail: { live, threads, rate_per_s: perSecond } }) {
  const pulse = document.getElementById("pulse");
  pulse.hidden = false;
  pulse.textContent =
    live === 0
      ? "no workers"
      : `${several(live, "worker")}, ${several(threads, "thread")}${perSecond > 0 ? `, ${rate(perSecond)}` : ""}`;
}

addEventListener("hashchange", show);
document.addEventListener("workforce", showPulse);
show();
