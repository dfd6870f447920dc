// Numbers and times as people read them.

const DASH = "\u2013";

/** A number with so many digits after the point; large ones with fewer. */
export function number(value, decimals = 2) {
  if (value === null || value === undefined || !Number.isFinite(value)) return DASH;
  const size = Math.abs(value);
  const digits = size >= 10_000 ? 0 : size >= 1_000 ? Math.min(decimals, 1) : decimals;
  const rounded = Number(value.toFixed(digits)) || 0;
  return rounded.toLocaleString("en", {
    minimumFractionDigits: digits,
    maximumFractionDigits: digits,
    useGrouping: size >= 10_000,
  });
}

export const count = (n) => n.toLocaleString("en");

/** `1 run`, `2 runs`. */
export const several = (n, word) => `${count(n)} ${word}${n === 1 ? "" : "s"}`;

/** The interval in brackets; an end that is null is open. */
export const interval = (ends, decimals) =>
  ends ? `[${number(ends[0], decimals)}, ${number(ends[1], decimals)}]` : "";

/** A time in its two largest units. */
export function duration(seconds) {
  if (seconds === null || seconds === undefined || !Number.isFinite(seconds)) return DASH;
  const whole = Math.round(seconds);
  if (whole < 60) return `${whole} s`;
  if (whole < 3_600) return `${Math.floor(whole / 60)} min ${whole % 60} s`;
  if (whole < 86_400) return `${Math.floor(whole / 3_600)} h ${Math.floor((whole % 3_600) / 60)} min`;
  return `${Math.floor(whole / 86_400)} d ${Math.floor((whole % 86_400) / 3_600)} h`;
}

export const date = (ms) => (ms === null ? DASH : new Date(ms).toLocaleString("sv").slice(0, 16));

/** Minutes, seconds and tenths of a clock. */
export function clock(seconds) {
  const minutes = Math.floor(seconds / 60);
  return `${minutes}:${(seconds - 60 * minutes).toFixed(1).padStart(4, "0")}`;
}

export const percent = (share) => `${Math.floor(100 * share)} %`;

/** A rate per second; slow ones per minute. */
export function rate(perSecond) {
  if (perSecond === null || perSecond === undefined) return DASH;
  return perSecond >= 1 || perSecond === 0 ? `${number(perSecond, 1)} / s` : `${number(60 * perSecond, 1)} / min`;
}

/** `algorithm=rgop` as a word for a heading: its labels alone. */
export const labels = (factors, order = Object.keys(factors)) =>
  order
    .filter((name) => name in factors)
    .map((name) => factors[name])
    .join(", ") || "all runs";

const UNITS = { m: "m", mm2: "mm\u00b2", s: "s", ms: "ms", rad: "rad", hz: "Hz", percent: "%" };

/** A metric's name in words, its unit in brackets: `cross_track_rms_m` is `cross track rms [m]`. */
export function words(name) {
  const parts = name.split("_");
  const unit = UNITS[parts.at(-1)];
  return unit ? `${parts.slice(0, -1).join(" ")} [${unit}]` : parts.join(" ");
}

export const title = (metric) =>
  metric.unit === "1" ? metric.title : `${metric.title} [${metric.unit.replace("^2", "\u00b2")}]`;
