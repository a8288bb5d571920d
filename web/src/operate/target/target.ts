/** Targets in the two forms the operator uses: range and bearing, and steps along and across the line. */

import type { Schema } from "../../session/client";

export type Target = Schema["TargetView"];

export const NUDGE_M = 0.05;

/** Full target from x, y, z in frame `machine`. */
export function fromPoint(x_m: number, y_m: number, z_m: number): Target {
  return { x_m, y_m, z_m, range_m: Math.hypot(x_m, y_m), azimuth_rad: Math.atan2(y_m, x_m) };
}

/** Full target from range, azimuth (positive to the left) and height. */
export function fromPolar(range_m: number, azimuth_rad: number, z_m: number): Target {
  return fromPoint(range_m * Math.cos(azimuth_rad), range_m * Math.sin(azimuth_rad), z_m);
}

/** A text that is the same for the same point. */
export const pointKey = ({ x_m, y_m, z_m }: Target) => `${x_m} ${y_m} ${z_m}`;

/** Move a target along its own line (positive longer) and across it (positive left). */
export function nudge(target: Target, long_m: number, left_m: number): Target {
  const cos = Math.cos(target.azimuth_rad);
  const sin = Math.sin(target.azimuth_rad);
  return fromPoint(
    target.x_m + long_m * cos - left_m * sin,
    target.y_m + long_m * sin + left_m * cos,
    target.z_m,
  );
}

/** Arrow keys to steps as seen from the machine: up is longer, left is left. */
export function nudgeOfKey(key: string): { long_m: number; left_m: number } | null {
  switch (key) {
    case "ArrowUp":
      return { long_m: NUDGE_M, left_m: 0 };
    case "ArrowDown":
      return { long_m: -NUDGE_M, left_m: 0 };
    case "ArrowLeft":
      return { long_m: 0, left_m: NUDGE_M };
    case "ArrowRight":
      return { long_m: 0, left_m: -NUDGE_M };
    default:
      return null;
  }
}

/** Same point within a millimetre: no reason to preview again. */
export function isSameTarget(a: Target | null, b: Target | null): boolean {
  if (a === null || b === null) return a === b;
  return Math.hypot(a.x_m - b.x_m, a.y_m - b.y_m, a.z_m - b.z_m) < 1e-3;
}
