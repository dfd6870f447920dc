// A run as an animation: play, pause, speed, and any moment by hand.

import { h, s, uniqueId } from "./dom.js";
import { clock, number, several } from "./format.js";
import { select } from "./frame.js";
import { Scene, distances, poseAt } from "./scene.js";

const SPEEDS = [1, 2, 5, 10, 20, 50, 100];
const FIRST_SPEED = 10;
/** Fields that are longer than wide by more are looked at from near. */
const NARROW = 0.25;
const [LOWEST_PX, HIGHEST_PX] = [220, 560];

/** Marks over the slider, where an operator had to help. */
function marks(replay, length) {
  if (replay.interventions.length === 0) return null;
  return s(
    "svg",
    { class: "marks", role: "img", "aria-label": several(replay.interventions.length, "intervention") },
    replay.interventions.map(({ time_s: when, cause }) =>
      s(
        "rect",
        { x: `${(100 * when) / length}%`, y: 0, width: 2, height: "100%" },
        s("title", {}, `${cause} at ${clock(when)}`),
      ),
    ),
  );
}

export function replayer(replay, signal) {
  const length = Math.max(replay.step_s * (replay.poses.length - 1), replay.step_s);
  const driven = distances(replay);
  const canvas = h("canvas", {
    id: "replay-canvas",
    role: "img",
    "aria-label": `Replay of the run in ${replay.field.name}, seen from above`,
  });
  const scene = new Scene(canvas, replay);
  scene.follow = scene.aspect < NARROW;
  let [time, playing, speed, before, frame] = [0, false, FIRST_SPEED, 0, 0];

  const play = h(
    "button",
    { type: "button", class: "primary", id: "replay-play", onclick: () => (playing ? pause() : start()) },
    "Play",
  );
  const slider = h("input", {
    type: "range",
    id: "replay-time",
    min: 0,
    max: length,
    step: replay.step_s,
    value: 0,
    "aria-label": "Time in the run",
    oninput: () => seek(Number(slider.value)),
  });
  const told = h("output", { for: "replay-time", id: "replay-told" });

  function draw() {
    scene.draw(time);
    const [x, y, heading] = poseAt(replay, time);
    const way = driven[Math.min(Math.round(time / replay.step_s), driven.length - 1)];
    slider.value = time;
    slider.setAttribute("aria-valuetext", `${clock(time)} of ${clock(length)}`);
    const degrees = Math.round((((((heading * 180) / Math.PI) % 360) + 540) % 360) - 180) || 0;
    told.textContent = `${clock(time)} of ${clock(length)} \u00b7 ${number(way, 1)} m driven \u00b7 x ${number(x, 2)} m, y ${number(y, 2)} m, ${degrees}\u00b0`;
  }
  function tick(now) {
    // A frame may bear an earlier time than the click that asked for it: the first one only starts the clock.
    time = Math.min(length, time + (before === null ? 0 : ((now - before) / 1000) * speed));
    before = now;
    draw();
    if (time >= length) pause();
    if (playing) frame = requestAnimationFrame(tick);
  }
  function start() {
    if (time >= length) time = 0;
    [playing, before] = [true, null];
    play.textContent = "Pause";
    frame = requestAnimationFrame(tick);
  }
  function pause() {
    playing = false;
    cancelAnimationFrame(frame);
    play.textContent = "Play";
  }
  function seek(to) {
    time = to;
    draw();
  }

  function fit() {
    const [width, dot] = [canvas.parentElement?.clientWidth ?? 0, window.devicePixelRatio || 1];
    if (width === 0) return;
    const wanted = scene.follow ? width * 0.5 : width * scene.aspect;
    const height = Math.round(Math.min(HIGHEST_PX, Math.max(LOWEST_PX, wanted)));
    canvas.width = Math.round(width * dot);
    canvas.height = Math.round(height * dot);
    canvas.style.height = `${height}px`;
    draw();
  }
  const toggle = (label, checked, set) => {
    const id = uniqueId("toggle");
    const box = h("input", {
      type: "checkbox",
      id,
      checked,
      onchange: (event) => {
        set(event.target.checked);
        fit();
      },
    });
    return h("div", { class: "check" }, box, h("label", { for: id }, label));
  };
  const zoom = h(
    "label",
    { class: "field" },
    h("span", {}, "Seen around the robot [m]"),
    h("input", {
      type: "range",
      min: 1,
      max: 12,
      step: 0.5,
      value: scene.reach_m,
      oninput: (event) => {
        scene.reach_m = Number(event.target.value);
        draw();
      },
    }),
  );
  zoom.hidden = !scene.follow;
  const follow = toggle("Follow the robot", scene.follow, (on) => {
    scene.follow = on;
    zoom.hidden = !on;
  });
  const stage = h("div", { class: "stage" }, canvas);
  const watch = new ResizeObserver(fit);
  watch.observe(stage);
  document.addEventListener("themechange", draw, { signal });
  signal.addEventListener("abort", () => {
    pause();
    watch.disconnect();
  });

  const key = (name, word) => h("li", {}, h("span", { class: `key ${name}` }), word);
  const { field } = replay;
  return h(
    "div",
    { class: "replay" },
    stage,
    h("div", { class: "scrub" }, marks(replay, length), slider),
    told,
    h(
      "div",
      { class: "choosing" },
      play,
      select(
        "Speed",
        SPEEDS.map((times) => [String(times), `${times} \u00d7`]),
        String(speed),
        (value) => {
          speed = Number(value);
        },
      ),
      zoom,
      h(
        "div",
        { class: "checks" },
        follow,
        toggle("LiDAR", true, (on) => {
          scene.shows.lidar = on;
        }),
        toggle("Lines found", true, (on) => {
          scene.shows.lines = on;
        }),
        toggle("Rows", true, (on) => {
          scene.shows.rows = on;
        }),
      ),
    ),
    h(
      "ul",
      { class: "legend" },
      key("crop", "crop"),
      field.weeds.length > 0 && key("weed", "weed"),
      field.leaves.length > 0 && key("leaf", "leaf"),
      field.litter.length > 0 && key("litter", "weed or fallen stalk"),
      field.damaged.length > 0 && key("bad", "run over"),
      key("lidar", "LiDAR return"),
      key("line", "line found"),
      key("path", "path"),
    ),
  );
}
