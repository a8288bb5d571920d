/** Points of a landing in frame `throw`: along the target line from the target, and left of it. */

import type { Plan, Throw } from "../session/live";

export type LandingPoint = { downrange_m: number; crossrange_m: number };

export function measuredOf(thrown: Throw): LandingPoint | null {
  const { measured_downrange_error_m: along, measured_crossrange_error_m: across } = thrown;
  return along === null || across === null ? null : { downrange_m: along, crossrange_m: across };
}

export function predictedOf(plan: Plan | null): LandingPoint | null {
  const prediction = plan?.prediction;
  if (!prediction) return null;
  return {
    downrange_m: prediction.downrange_error_m,
    crossrange_m: prediction.crossrange_error_m,
  };
}

/** A point on the ground, m in frame `machine`, as an error of a throw at a target. */
export function errorOf(
  point: { x_m: number; y_m: number },
  target: { range_m: number; azimuth_rad: number },
): LandingPoint {
  const cos = Math.cos(target.azimuth_rad);
  const sin = Math.sin(target.azimuth_rad);
  return {
    downrange_m: cos * point.x_m + sin * point.y_m - target.range_m,
    crossrange_m: cos * point.y_m - sin * point.x_m,
  };
}
