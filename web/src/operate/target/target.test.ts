import { describe, expect, it } from "vitest";
import { fromPoint, fromPolar, isSameTarget, nudge, nudgeOfKey } from "./target";

describe("targets", () => {
  it("agree in both forms", () => {
    const target = fromPolar(9, Math.PI / 6, 0.5);
    expect(target.x_m).toBeCloseTo(7.794, 3);
    expect(target.y_m).toBeCloseTo(4.5, 6);
    expect(fromPoint(target.x_m, target.y_m, 0.5)).toEqual(target);
  });

  it("move along and across their own line", () => {
    const target = fromPolar(9, 0.7, 0);
    expect(nudge(target, 0.05, 0).range_m).toBeCloseTo(9.05, 9);
    expect(nudge(target, 0.05, 0).azimuth_rad).toBeCloseTo(0.7, 9);
    expect(nudge(target, 0, 0.05).azimuth_rad).toBeGreaterThan(0.7);
  });

  it("keep their height", () => {
    expect(nudge(fromPolar(9, 0, 1.2), 0.05, 0.05).z_m).toBe(1.2);
  });

  it("follow the arrow keys by 5 cm", () => {
    expect(nudgeOfKey("ArrowUp")).toEqual({ long_m: 0.05, left_m: 0 });
    expect(nudgeOfKey("ArrowRight")).toEqual({ long_m: 0, left_m: -0.05 });
    expect(nudgeOfKey("a")).toBeNull();
  });

  it("compare to a millimetre", () => {
    expect(isSameTarget(fromPoint(9, 0, 0), fromPoint(9.0005, 0, 0))).toBe(true);
    expect(isSameTarget(fromPoint(9, 0, 0), fromPoint(9.05, 0, 0))).toBe(false);
    expect(isSameTarget(null, null)).toBe(true);
    expect(isSameTarget(null, fromPoint(9, 0, 0))).toBe(false);
  });
});
