// Drawings of results, as SVG made here.

import { h, put, s } from "./dom.js";
import { labels, number, title } from "./format.js";
import { note } from "./frame.js";
import { scaleOf } from "./scale.js";
import { varying } from "./table.js";

const [ROW, MARGIN, AXIS, LETTER] = [26, 14, 34, 6.8];
/** Labels take so much of a plot's width at most. */
const LABEL_SHARE = 0.42;
const LONGEST_LABEL = 34;
export const MOST_ROWS = 80;
const COLOURS = 8;

const cut = (text, longest = LONGEST_LABEL) => (text.length > longest ? `${text.slice(0, longest - 1)}\u2026` : text);

/** The value below which so much of `sorted` lies. */
function quantile(sorted, part) {
  const place = part * (sorted.length - 1);
  const below = Math.floor(place);
  const above = Math.min(below + 1, sorted.length - 1);
  return sorted[below] + (place - below) * (sorted[above] - sorted[below]);
}

/** Round numbers from `low` to `high`. */
function ticks(low, high, most) {
  const rough = (high - low) / most;
  if (!(rough > 0)) return [low];
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((n) => n * power).find((n) => n >= rough);
  const found = [];
  for (let value = Math.ceil(low / step) * step; value <= high + step * 1e-6; value += step) found.push(value);
  return found;
}

/** From values to places between `from` and `to`, and where to mark the axis. */
function axis(metric, all, from, to, withNought = true) {
  const { at, low, high, logarithmic } = scaleOf(metric, all, withNought);
  const place = (value) => from + at(value) * (to - from);
  const most = Math.max(3, Math.floor(Math.abs(to - from) / 80));
  if (!logarithmic) return { at: place, marks: ticks(low, high, most) };
  const [first, last] = [Math.ceil(Math.log10(low)), Math.floor(Math.log10(high))];
  const step = Math.max(1, Math.ceil((last - first) / most));
  const powers = [];
  for (let power = first; power <= last; power += step) powers.push(10 ** power);
  return { at: place, marks: powers };
}

const short = (value) =>
  value !== 0 && (Math.abs(value) >= 1e5 || Math.abs(value) < 1e-3)
    ? value.toExponential(0)
    : String(Number(value.toPrecision(4)));

function xAxis(scale, metric, y, height, middle) {
  return [
    scale.marks.map((value) => [
      s("line", { class: "grid", x1: scale.at(value), x2: scale.at(value), y1: y - height, y2: y }),
      s("text", { x: scale.at(value), y: y + 15, "text-anchor": "middle" }, short(value)),
    ]),
    s("text", { class: "axis", x: middle, y: y + 30, "text-anchor": "middle" }, title(metric)),
  ];
}

/** A strip of single runs for each cell, with a box from quartile to quartile around the median. */
export function strips(cells, metric, width) {
  const shown = cells
    .map((cell) => ({ ...cell, values: cell.metrics[metric.name] ?? [] }))
    .filter((cell) => cell.values.some(Number.isFinite))
    .slice(0, MOST_ROWS);
  if (shown.length === 0) return note("No run has a value of this metric yet.");
  const names = varying([...new Set(shown.flatMap((cell) => Object.keys(cell.factors)))], shown);
  const named = shown.map((cell) => labels(cell.factors, names));
  const longest = Math.min(Math.max(...named.map((name) => name.length)), Math.floor((width * LABEL_SHARE) / LETTER));
  const left = shown.length > 1 ? Math.round(longest * LETTER + MARGIN) : MARGIN;
  const all = shown.flatMap((cell) => cell.values.filter(Number.isFinite));
  const scale = axis(
    metric,
    all.map((mean) => ({ mean })),
    left,
    width - MARGIN,
    false,
  );
  const bottom = shown.length * ROW + 6;
  const rows = shown.map((cell, row) => {
    const y = row * ROW + ROW / 2 + 4;
    const sorted = cell.values.filter(Number.isFinite).sort((a, b) => a - b);
    const [low, middle, high] = [0.25, 0.5, 0.75].map((part) => scale.at(quantile(sorted, part)));
    const dots = cell.values.map(
      (value, i) =>
        Number.isFinite(value) &&
        s(
          "a",
          { href: `#/runs/${cell.jobs[i]}`, tabindex: "-1" },
          s(
            "circle",
            {
              class: cell.outcomes[i] === "success" ? "run good" : "run",
              cx: scale.at(value),
              cy: y + ((i * 7) % 11) - 5,
              r: 3,
            },
            s("title", {}, `seed ${cell.seeds[i]}, ${cell.outcomes[i]}: ${number(value, metric.decimals)}`),
          ),
        ),
    );
    return [
      left > MARGIN && s("text", { x: left - 8, y: y + 4, "text-anchor": "end" }, cut(named[row], longest)),
      sorted.length > 3 && s("rect", { class: "box", x: low, y: y - 8, width: Math.max(1, high - low), height: 16 }),
      dots.filter(Boolean),
      s("line", { class: "median", x1: middle, x2: middle, y1: y - 9, y2: y + 9 }),
    ];
  });
  return s(
    "svg",
    {
      class: "plot",
      width,
      height: bottom + AXIS,
      role: "img",
      "aria-label": `${title(metric)} of single runs, by cell`,
    },
    xAxis(scale, metric, bottom, bottom, (left + width) / 2),
    rows.flat(3).filter(Boolean),
  );
}

/** Means by two factors, the more the darker. */
export function heatMap(cells, metric, [rowFactor, columnFactor]) {
  const of = (factor) => [...new Set(cells.map((cell) => cell.factors[factor]))];
  const [rows, columns, size] = [of(rowFactor), of(columnFactor), { width: 92, height: 36 }];
  const scale = scaleOf(
    metric,
    cells.map((cell) => ({ mean: cell.metrics[metric.name]?.mean })),
  );
  const left = 20 + 7 * Math.max(...rows.map((row) => cut(row).length));
  const squares = cells.map((cell) => {
    const mean = cell.metrics[metric.name]?.mean;
    const [x, y] = [
      left + columns.indexOf(cell.factors[columnFactor]) * size.width,
      26 + rows.indexOf(cell.factors[rowFactor]) * size.height,
    ];
    const share = Number.isFinite(mean) ? scale.at(mean) : null;
    return [
      share !== null &&
        s("rect", {
          class: "heat",
          x,
          y,
          width: size.width - 2,
          height: size.height - 2,
          "fill-opacity": (0.06 + 0.94 * share).toFixed(3),
        }),
      s(
        "text",
        { class: share > 0.55 ? "on" : "", x: x + size.width / 2 - 1, y: y + 22, "text-anchor": "middle" },
        number(mean, metric.decimals),
      ),
    ];
  });
  return s(
    "svg",
    {
      class: "plot",
      width: left + columns.length * size.width,
      height: 30 + rows.length * size.height,
      role: "img",
      "aria-label": `${title(metric)} by ${rowFactor} and ${columnFactor}`,
    },
    columns.map((word, i) =>
      s("text", { x: left + (i + 0.5) * size.width, y: 17, "text-anchor": "middle" }, cut(word)),
    ),
    rows.map((word, i) => s("text", { x: left - 8, y: 26 + i * size.height + 22, "text-anchor": "end" }, cut(word))),
    squares.flat().filter(Boolean),
  );
}

/** A dot for each cell: its success ratio to the right, its error upward, with the intervals of both. */
export function scatter(cells, [across, up], colourBy, width) {
  const shown = cells.filter(
    (cell) => Number.isFinite(cell.metrics[across.name]?.mean) && Number.isFinite(cell.metrics[up.name]?.mean),
  );
  if (shown.length === 0) return note("No cell has both values yet.");
  const groups = [...new Set(shown.map((cell) => cell.factors[colourBy]))];
  const [left, bottom] = [64, 300];
  const x = axis(
    across,
    shown.map((cell) => cell.metrics[across.name]),
    left,
    width - MARGIN - 6,
  );
  const y = axis(
    up,
    shown.map((cell) => cell.metrics[up.name]),
    bottom,
    12,
  );
  const marks = shown.map((cell) => {
    const [ratio, error] = [cell.metrics[across.name], cell.metrics[up.name]];
    const [cx, cy, colour] = [
      x.at(ratio.mean),
      y.at(error.mean),
      `c${groups.indexOf(cell.factors[colourBy]) % COLOURS}`,
    ];
    const inside = (value) => Math.min(bottom, Math.max(12, value));
    return [
      ratio.ci95 &&
        s("line", { class: `whisker ${colour}`, x1: x.at(ratio.ci95[0]), x2: x.at(ratio.ci95[1]), y1: cy, y2: cy }),
      error.ci95 &&
        Number.isFinite(error.ci95[0]) &&
        Number.isFinite(error.ci95[1]) &&
        s("line", {
          class: `whisker ${colour}`,
          x1: cx,
          x2: cx,
          y1: inside(y.at(error.ci95[0])),
          y2: inside(y.at(error.ci95[1])),
        }),
      s(
        "circle",
        { class: `dot ${colour}`, cx, cy, r: 5 },
        s("title", {}, `${labels(cell.factors)}: ${number(ratio.mean)}, ${number(error.mean, up.decimals)}`),
      ),
    ];
  });
  const grid = y.marks.map((value) => [
    s("line", { class: "grid", x1: left, x2: width - MARGIN, y1: y.at(value), y2: y.at(value) }),
    s("text", { x: left - 6, y: y.at(value) + 4, "text-anchor": "end" }, short(value)),
  ]);
  const legend =
    groups.length > 1 &&
    h(
      "ul",
      { class: "legend" },
      groups.map((word, i) =>
        h(
          "li",
          {},
          s("svg", { width: 12, height: 12 }, s("circle", { class: `dot c${i % COLOURS}`, cx: 6, cy: 6, r: 5 })),
          word,
        ),
      ),
    );
  return [
    h("p", { class: "muted" }, title(up)),
    s(
      "svg",
      {
        class: "plot",
        width,
        height: bottom + AXIS,
        role: "img",
        "aria-label": `${title(up)} against ${title(across)}, a dot for each cell`,
      },
      grid.flat(),
      xAxis(x, across, bottom, bottom - 12, (left + width) / 2).flat(2),
      marks.flat().filter(Boolean),
    ),
    legend,
  ];
}

/** Calls `draw` with the width of `place`, and again when that changes. */
function atWidth(place, draw, signal) {
  let drawn = 0;
  const watch = new ResizeObserver(() => {
    const width = Math.floor(place.clientWidth);
    if (width === drawn || width === 0) return;
    drawn = width;
    put(place, draw(width));
  });
  watch.observe(place);
  signal.addEventListener("abort", () => watch.disconnect());
}

/** A part of the page that a drawing of a width fills. */
export function figure(draw, signal) {
  const place = h("div", { class: "figure" });
  atWidth(place, draw, signal);
  return place;
}
