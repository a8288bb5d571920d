/** Round steps for axes and scale bars. */

const STEPS = [1, 2, 5];

/** The largest 1, 2 or 5 times a power of ten that is not above `limit`. */
export function niceStep(limit: number): number {
  const power = 10 ** Math.floor(Math.log10(limit));
  const fitting = STEPS.filter((step) => step * power <= limit * (1 + 1e-9));
  return (fitting.at(-1) ?? 1) * power;
}

/** Least half height of an axis of misses, m: below it their differences are noise, and labels grow long. */
export const LEAST_MISS_M = 0.05;

/** Symmetric limits around zero that hold all values, with room. */
export function symmetricLimit(values: readonly number[], least: number): number {
  return values.reduce((limit, value) => Math.max(limit, Math.abs(value)), least) * 1.12;
}
