import { expect, it } from "vitest";
import { errorOf } from "./marking";

it.each([
  [{ x_m: 9, y_m: 0 }, 0, 0, 0],
  [{ x_m: 9.5, y_m: 0.2 }, 0, 0.5, 0.2],
  // The same about a target at the left: long is away from the machine, left stays left of the line.
  [{ x_m: -0.2, y_m: 9.5 }, Math.PI / 2, 0.5, 0.2],
])("a point %j at azimuth %d is %d m long and %d m left", (point, azimuth_rad, long, left) => {
  const error = errorOf(point, { range_m: 9, azimuth_rad });
  expect(error.downrange_m).toBeCloseTo(long, 9);
  expect(error.crossrange_m).toBeCloseTo(left, 9);
});
