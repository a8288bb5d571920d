/** The points of a machine's trend: chosen by mode and range, and their running median. */

import type { Schema } from "../session/client";

export type TrendPoint = Schema["TrendPoint"];
export type Version = Schema["VersionChange"];
export type Axis = "downrange" | "crossrange";
export type Mode = TrendPoint["mode"];

/** Throws on each side of one that its running median takes in. */
const HALF_WINDOW = 10;

export type RangeBin = { from_m: number; to_m: number; words: string };

const BIN_M = 1;

/** Bins of a metre that have throws, in order. */
export function rangeBins(points: readonly TrendPoint[]): RangeBin[] {
  const starts = new Set(points.map((point) => Math.floor(point.range_m / BIN_M) * BIN_M));
  return [...starts]
    .sort((a, b) => a - b)
    .map((from_m) => ({
      from_m,
      to_m: from_m + BIN_M,
      words: `${from_m} to ${from_m + BIN_M} m`,
    }));
}

export const chosenPoints = (points: readonly TrendPoint[], mode: Mode, bin: RangeBin | null) =>
  points.filter(
    (point) =>
      point.mode === mode &&
      (bin === null || (point.range_m >= bin.from_m && point.range_m < bin.to_m)),
  );

/** Changes of a mode's version within the time of the points; the first version is no change. */
export function chosenVersions(
  versions: readonly Version[],
  points: readonly TrendPoint[],
  mode: Mode,
): Version[] {
  const first = points[0];
  if (!first) return [];
  return versions.filter(
    (version) => version.mode === mode && version.since_utc > first.created_utc,
  );
}

function median(values: readonly number[]): number {
  const sorted = [...values].sort((a, b) => a - b);
  const middle = sorted.length >> 1;
  const upper = sorted[middle] ?? 0;
  return sorted.length % 2 === 1 ? upper : (upper + (sorted[middle - 1] ?? 0)) / 2;
}

/** Running median over neighbouring throws of one version: a change of version is no drift. */
export function medians(points: readonly TrendPoint[], axis: Axis) {
  return points.map((point, index) => {
    const near = points
      .slice(Math.max(0, index - HALF_WINDOW), index + HALF_WINDOW + 1)
      .filter((other) => other.policy_sha256 === point.policy_sha256);
    return {
      time: new Date(point.created_utc),
      value_m: median(near.map((other) => other[`${axis}_error_m`])),
    };
  });
}
