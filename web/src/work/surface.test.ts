import { describe, expect, it } from "vitest";
import { cornersOf, fromLocal, toLocal } from "./rectangle";
import {
  contourLevels,
  contourSegments,
  type Heights,
  heightAt,
  heightRange,
  section,
  windowOf,
} from "./surface";
import { strength } from "./tone";

const CELL = 0.1;
const axis = (from: number, count: number) =>
  Array.from({ length: count }, (_, index) => Number((from + CELL * index).toFixed(3)));
const GRID = { x_m: axis(4, 61), y_m: axis(-3, 61) };
const heights = (of: (x: number, y: number) => number): Heights =>
  GRID.y_m.map((y) => GRID.x_m.map((x) => of(x, y)));
/** A cone of 1.5 m with slopes of 1 in 1 about x 7, y 0. */
const CONE = heights((x, y) => Math.max(0, 1.5 - Math.hypot(x - 7, y)));

describe("contour lines", () => {
  it("lie on the cone's circles, once around", () => {
    for (const level of [0.2, 0.7, 1.2]) {
      const segments = contourSegments(GRID, CONE, level);
      const radius = 1.5 - level;
      for (const [ax, ay, bx, by] of segments) {
        expect(Math.abs(Math.hypot(ax - 7, ay) - radius)).toBeLessThan(0.01);
        expect(Math.abs(Math.hypot(bx - 7, by) - radius)).toBeLessThan(0.01);
      }
      const length = segments.reduce(
        (sum, [ax, ay, bx, by]) => sum + Math.hypot(bx - ax, by - ay),
        0,
      );
      expect(Math.abs(length / (2 * Math.PI * radius) - 1)).toBeLessThan(0.02);
    }
  });

  it("leave out walls, and ground that is level at their height", () => {
    const step = heights((x) => (x < 7 ? 0 : 0.8));
    expect(contourSegments(GRID, step, 0.4)).toEqual([]);
    expect(contourSegments(GRID, step, 0)).toEqual([]);
  });

  it("stand at round heights within the ground's", () => {
    expect(contourLevels(-0.8, 0)).toEqual({
      step_m: 0.1,
      levels: [-0.8, -0.7, -0.6, -0.5, -0.4, -0.3, -0.2, -0.1],
    });
    expect(contourLevels(1.2, 1.23).levels).toEqual([]);
  });
});

describe("heights", () => {
  it("are read between cells, and not beside the grid", () => {
    const slope = heights((x, y) => 2 * x + y);
    expect(heightAt(GRID, slope, [6.234, 1.077])).toBeCloseTo(2 * 6.234 + 1.077, 6);
    expect(heightAt(GRID, slope, [3.8, 0])).toBeNull();
    expect(heightAt(GRID, slope, [4, -3])).toBeCloseTo(5, 6);
    expect(heightAt(GRID, slope, [10, 3])).toBeCloseTo(23, 6);
  });

  it("are shown around what matters, with stronger tones the higher they are", () => {
    const window = windowOf(GRID, [
      [7, 0],
      [8, 1],
      [40, 0],
    ]);
    expect(window.x[0]).toBeCloseTo(5.8);
    expect(window.x[1]).toBeCloseTo(9.2);
    const [low, high] = heightRange(GRID, CONE, window);
    expect([low, high]).toEqual([0, 1.5]);
    expect(strength(low, low, high)).toBe(0);
    expect(strength(0.5, low, high)).toBeLessThan(strength(1, low, high));
    expect(strength(9, low, high)).toBe(strength(high, low, high));
    expect(strength(0, 0, 0)).toBe(0);
  });
});

describe("sections", () => {
  const place = { x_m: 7, y_m: 0, length_m: 2, width_m: 1, turn_rad: Math.PI / 2 };

  it("run along the turned place, with what is wanted inside of it only", () => {
    const wanted = heights(() => 0.9);
    const tilted = heights((_, y) => y);
    const surface = { ...GRID, start_m: heights(() => 0), height_m: tilted, wanted_m: wanted };
    const along = section(surface, place, "along");
    const at = (m: number) => along.find((point) => Math.abs(point.at_m - m) < 1e-6);
    // Its length points to the left: one metre to its front is one metre of y.
    expect(at(0.5)).toMatchObject({ now_m: expect.closeTo(0.5), start_m: 0, wanted_m: 0.9 });
    expect(at(1.5)?.wanted_m).toBeNull();
    const across = section(surface, place, "across");
    expect(across.every((point) => Math.abs(point.now_m) < 1e-9)).toBe(true);
  });

  it("show a wall of one cell at its full height, however the place is turned", () => {
    for (const turn_rad of [0, 0.4, -0.92]) {
      const bed = { x_m: 7, y_m: 0, length_m: 2, width_m: 1, turn_rad };
      const walled = heights((x, y) => {
        const [along, across] = toLocal(bed, [x, y]);
        const out = Math.max(Math.abs(along) - 1, Math.abs(across) - 0.5);
        return out > 0.15 ? 0 : out > 0 ? 1.8 : 1.2;
      });
      const surface = { ...GRID, start_m: walled, height_m: walled, wanted_m: walled };
      for (const direction of ["along", "across"] as const) {
        const points = section(surface, bed, direction);
        const sides = [points.filter((one) => one.at_m < 0), points.filter((one) => one.at_m > 0)];
        for (const side of sides) expect(Math.max(...side.map((one) => one.now_m))).toBe(1.8);
      }
    }
  });

  it("end at the grid", () => {
    const surface = { ...GRID, start_m: CONE, height_m: CONE, wanted_m: CONE };
    const points = section(surface, { ...place, y_m: 2.5 }, "along");
    expect(points.at(-1)?.at_m).toBeCloseTo(0.5);
  });
});

describe("places", () => {
  it("turn about their centre and back", () => {
    const place = { x_m: 7.4, y_m: 5.6, length_m: 4.4, width_m: 2.4, turn_rad: -0.92 };
    for (const corner of cornersOf(place)) {
      const [along, across] = toLocal(place, corner);
      expect(Math.abs(along)).toBeCloseTo(2.2);
      expect(Math.abs(across)).toBeCloseTo(1.2);
    }
    const [x, y] = fromLocal(place, toLocal(place, [6.1, 5.2]));
    expect([x, y]).toEqual([expect.closeTo(6.1), expect.closeTo(5.2)]);
  });
});
