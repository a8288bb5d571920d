/** Machine, mode, pace and target in the address of page Operate; anything unreadable is left out. */

import { fromPolar, type Target } from "./target";

/** Range and height in m, azimuth in degrees, left positive. */
export type AimSearch = {
  machine?: string;
  mode?: "2d" | "3d";
  pace?: number;
  range?: number;
  azimuth?: number;
  height?: number;
};

const DEGREES = 180 / Math.PI;
const RANGE_M = { min: 0.5, max: 60 };
const HEIGHT_M = { min: -1, max: 3 };

function within(value: unknown, min: number, max: number): number | undefined {
  const found = typeof value === "string" && value !== "" ? Number(value) : value;
  return typeof found === "number" && found >= min && found <= max ? found : undefined;
}

export function parseAim(search: Record<string, unknown>): AimSearch {
  const { machine, mode } = search;
  const range = within(search.range, RANGE_M.min, RANGE_M.max);
  const parsed: AimSearch = {
    // A name of digits only arrives as a number.
    machine: ["string", "number"].includes(typeof machine)
      ? String(machine) || undefined
      : undefined,
    mode: mode === "2d" || mode === "3d" ? mode : undefined,
    pace: within(search.pace, 0, 1),
    range,
    azimuth: range === undefined ? undefined : within(search.azimuth, -180, 180),
    height: range === undefined ? undefined : within(search.height, HEIGHT_M.min, HEIGHT_M.max),
  };
  return Object.fromEntries(
    Object.entries(parsed).filter(([, value]) => value !== undefined),
  ) as AimSearch;
}

/** Null where the address names no target. */
export function targetOf({ range, azimuth = 0, height = 0 }: AimSearch): Target | null {
  return range === undefined ? null : fromPolar(range, azimuth / DEGREES, height);
}

export function aimSearch(machine: string, mode: "2d" | "3d", target: Target | null): AimSearch {
  if (target === null) return { machine, mode };
  const aim: AimSearch = {
    machine,
    mode,
    range: Number(target.range_m.toFixed(2)),
    azimuth: Number((target.azimuth_rad * DEGREES).toFixed(2)),
  };
  const height = Number(target.z_m.toFixed(2));
  return height === 0 ? aim : { ...aim, height };
}
