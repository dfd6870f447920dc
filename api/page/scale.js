// Where values lie between the smallest and the largest.

/** Beyond this ratio of the largest to the smallest mean, scales are logarithmic; they reach down to so much of the largest. */
const [WIDE, DEEPEST] = [100, 1e-6];

/** Where a value lies between all means and ends of intervals, from 0 to 1; with nought, if asked to. */
export function scaleOf(metric, all, withNought = true) {
  if (metric.ratio) return { at: (value) => value, low: 0, high: 1, logarithmic: false };
  const means = all.map((statistics) => statistics.mean).filter(Number.isFinite);
  const ends = [...means, ...all.flatMap((statistics) => statistics.ci95 ?? []).filter(Number.isFinite)];
  const high = Math.max(...ends);
  if (means.every((value) => value > 0) && Math.max(...means) > WIDE * Math.min(...means)) {
    const low = Math.max(DEEPEST * high, Math.min(...ends.filter((value) => value > 0)));
    return { at: (value) => Math.log(Math.max(value, low) / low) / Math.log(high / low), low, high, logarithmic: true };
  }
  const low = Math.min(...ends, ...(withNought ? [0] : []));
  return { at: (value) => (high > low ? (value - low) / (high - low) : 0.5), low, high, logarithmic: false };
}
