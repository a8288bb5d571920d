import { describe, expect, it } from "vitest";
import { ellipsePath, ellipsePoints, sigmaDistance } from "./ellipse";
import { niceStep, symmetricLimit } from "./scale";

const spread = {
  mean_downrange_error_m: 0.1,
  mean_crossrange_error_m: -0.05,
  sd_downrange_m: 0.2,
  sd_crossrange_m: 0.1,
  correlation_ratio: 0.6,
};

describe("sigma ellipses", () => {
  it.each([1, 2])("at %d sigma every point is that many sigma away", (sigma) => {
    for (const { x_m, y_m } of ellipsePoints(spread, sigma)) {
      expect(sigmaDistance(spread, x_m, y_m)).toBeCloseTo(sigma, 9);
    }
  });

  it("span the standard deviations", () => {
    const xs = ellipsePoints(spread, 1).map((p) => p.x_m);
    expect(Math.max(...xs)).toBeCloseTo(0.3, 6);
    expect(Math.min(...xs)).toBeCloseTo(-0.1, 6);
  });

  it("have no distance when there is no spread", () => {
    expect(sigmaDistance({ ...spread, sd_downrange_m: 0 }, 1, 1)).toBeNull();
    expect(sigmaDistance({ ...spread, correlation_ratio: 1 }, 1, 1)).toBeNull();
  });

  it("close as paths", () => {
    expect(
      ellipsePath(
        spread,
        1,
        (m) => m,
        (m) => -m,
      ),
    ).toMatch(/^M.*Z$/);
  });
});

describe("scales", () => {
  it("step in 1, 2, 5", () => {
    expect(niceStep(0.37)).toBeCloseTo(0.2);
    expect(niceStep(0.05)).toBeCloseTo(0.05);
    expect(niceStep(1)).toBe(1);
    expect(niceStep(9)).toBe(5);
  });

  it("hold every value about zero", () => {
    expect(symmetricLimit([-0.5, 0.2], 0.1)).toBeGreaterThan(0.5);
    expect(symmetricLimit([], 0.1)).toBeCloseTo(0.112);
  });
});
