import type { Schema } from "../../session/client";

type Clearance = Schema["ClearanceView"];

export type Margin = { name: string; margin_m: number | null; margin_rad: number | null };

/** A radian of joint counts like a metre of clearance when the nearest limit is chosen. */
const METRES_PER_RADIAN = 1;

function margin({ name, value_m, limit_m, value_rad, limit_rad }: Clearance): Margin {
  const margin_m = value_m === null ? null : value_m - (limit_m ?? 0);
  const margin_rad = value_rad === null ? null : value_rad - (limit_rad ?? 0);
  return { name, margin_m, margin_rad };
}

/** The clearance with the least room left; null when the preview names none. */
export function nearestClearance(clearances: readonly Clearance[]): Margin | null {
  const size = (m: Margin) => m.margin_m ?? (m.margin_rad ?? Infinity) * METRES_PER_RADIAN;
  return clearances.map(margin).sort((a, b) => size(a) - size(b))[0] ?? null;
}
