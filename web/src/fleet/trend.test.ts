import { describe, expect, it } from "vitest";
import { chosenPoints, chosenVersions, medians, rangeBins, type TrendPoint } from "./trend";

function point(minute: number, changes: Partial<TrendPoint> = {}): TrendPoint {
  return {
    throw_id: String(minute),
    created_utc: `2026-11-27T12:${String(minute).padStart(2, "0")}:00Z`,
    mode: "2d",
    range_m: 9.2,
    policy_sha256: "a",
    downrange_error_m: 0,
    crossrange_error_m: 0,
    ...changes,
  };
}

const version = (minute: number, mode: "2d" | "3d" = "2d") => ({
  mode,
  policy_id: "v",
  policy_sha256: "a",
  since_utc: `2026-11-27T12:${String(minute).padStart(2, "0")}:00Z`,
});

describe("points of a trend", () => {
  it("are chosen by mode and metre of range", () => {
    const all = [point(1), point(2, { mode: "3d" }), point(3, { range_m: 10 })];
    const bins = rangeBins(all);
    expect(bins.map((bin) => bin.words)).toEqual(["9 to 10 m", "10 to 11 m"]);
    const ids = (points: TrendPoint[]) => points.map((one) => one.throw_id);
    expect(ids(chosenPoints(all, "2d", null))).toEqual(["1", "3"]);
    expect(ids(chosenPoints(all, "2d", bins[1] ?? null))).toEqual(["3"]);
  });

  it("mark changes of their mode's version, not the first one", () => {
    const points = [point(5), point(9)];
    const versions = [version(8), version(7, "3d"), version(1)];
    expect(chosenVersions(versions, points, "2d")).toEqual([version(8)]);
    expect(chosenVersions(versions, [], "2d")).toEqual([]);
  });

  it("have a running median that an outlier does not move and a new version does not smear", () => {
    const points = Array.from({ length: 30 }, (_, i) =>
      point(i, {
        downrange_error_m: i === 4 ? 9 : i < 15 ? 0.1 : 0.5,
        policy_sha256: i < 15 ? "a" : "b",
      }),
    );
    const values = medians(points, "downrange").map((one) => one.value_m);
    expect(values.slice(0, 15)).toEqual(Array(15).fill(0.1));
    expect(values.slice(15)).toEqual(Array(15).fill(0.5));
  });

  it("have the mean of the middle two as the median of an even number", () => {
    const two = [point(1, { crossrange_error_m: 1 }), point(2, { crossrange_error_m: 2 })];
    expect(medians(two, "crossrange").map((one) => one.value_m)).toEqual([1.5, 1.5]);
  });
});
