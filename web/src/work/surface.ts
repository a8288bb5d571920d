/** Heights on a grid as a map and as sections: contour lines, tones, sampling. Frame `machine`, m. */

import { niceStep } from "../charts/scale";
import type { Point, Rectangle } from "./rectangle";
import { fromLocal, toLocal } from "./rectangle";

/** Rows along y, columns along x. */
export type Heights = readonly (readonly number[])[];
export type Grid = { x_m: readonly number[]; y_m: readonly number[] };
export type Window = { x: readonly [number, number]; y: readonly [number, number] };

const MARGIN_M = 1.2;
const LEAST_STEP_M = 0.05;
const LINE_COUNT = 5;
/** Rise over run from which on a side is a wall, which contour lines would only blacken. */
const WALL_SLOPE = 2.2;
/** Keeps lines off ground that is level at exactly their height. */
const OFF_LEVEL_M = 1e-6;

export const cellOf = (grid: Grid) => (grid.x_m[1] ?? 1) - (grid.x_m[0] ?? 0);

/** The part of the grid around points. */
export function windowOf(grid: Grid, points: readonly Point[]): Window {
  const axis = (all: readonly number[], used: readonly number[]): [number, number] => {
    const [first, last] = [all[0] ?? 0, all.at(-1) ?? 0];
    if (used.length === 0) return [first, last];
    const low = Math.max(first, Math.min(...used) - MARGIN_M);
    const high = Math.min(last, Math.max(...used) + MARGIN_M);
    return low < high ? [low, high] : [first, last];
  };
  const inside = points.filter((point) => heightAt(grid, null, point) !== null);
  return {
    x: axis(
      grid.x_m,
      inside.map(([x]) => x),
    ),
    y: axis(
      grid.y_m,
      inside.map(([, y]) => y),
    ),
  };
}

/** Lowest and highest height in a window. */
export function heightRange(grid: Grid, heights: Heights, window: Window): [number, number] {
  let [low, high] = [Number.POSITIVE_INFINITY, Number.NEGATIVE_INFINITY];
  grid.y_m.forEach((y, row) => {
    if (y < window.y[0] || y > window.y[1]) return;
    grid.x_m.forEach((x, column) => {
      const height = heights[row]?.[column];
      if (x < window.x[0] || x > window.x[1] || height === undefined) return;
      low = Math.min(low, height);
      high = Math.max(high, height);
    });
  });
  return low <= high ? [low, high] : [0, 0];
}

/** Heights of contour lines, at round steps. */
export function contourLevels(low: number, high: number): { step_m: number; levels: number[] } {
  if (high - low < LEAST_STEP_M) return { step_m: LEAST_STEP_M, levels: [] };
  const step_m = Math.max(LEAST_STEP_M, niceStep((high - low) / LINE_COUNT));
  const levels: number[] = [];
  for (let number = Math.ceil(low / step_m); number * step_m < high; number += 1)
    levels.push(Number((number * step_m).toFixed(6)));
  return { step_m, levels };
}

export type Segment = readonly [number, number, number, number];

/** The line at a level: every square of the grid is cut into two triangles; walls are left out. */
export function contourSegments(grid: Grid, heights: Heights, level_m: number): Segment[] {
  const level = level_m + OFF_LEVEL_M;
  const steepest = WALL_SLOPE * cellOf(grid);
  const found: Segment[] = [];
  for (let row = 0; row + 1 < grid.y_m.length; row += 1) {
    for (let column = 0; column + 1 < grid.x_m.length; column += 1) {
      const corner = (r: number, c: number): Corner => [
        grid.x_m[column + c] ?? 0,
        grid.y_m[row + r] ?? 0,
        heights[row + r]?.[column + c] ?? 0,
      ];
      const corners = [corner(0, 0), corner(0, 1), corner(1, 1), corner(1, 0)] as const;
      const z = corners.map((each) => each[2]);
      const [low, high] = [Math.min(...z), Math.max(...z)];
      if (high <= level || low > level || high - low > steepest) continue;
      const [a, b, c, d] = corners;
      for (const triangle of [[a, b, c] as const, [a, c, d] as const]) {
        const cut = crossings(triangle, level);
        if (cut.length === 4) found.push(cut as unknown as Segment);
      }
    }
  }
  return found;
}

type Corner = readonly [number, number, number];

/** Where a level cuts the edges of a triangle, as x, y, x, y. */
function crossings([a, b, c]: readonly [Corner, Corner, Corner], level: number): number[] {
  const points: number[] = [];
  for (const [from, to] of [
    [a, b],
    [b, c],
    [c, a],
  ] as const) {
    if (from[2] > level === to[2] > level) continue;
    const part = (level - from[2]) / (to[2] - from[2]);
    points.push(from[0] + part * (to[0] - from[0]), from[1] + part * (to[1] - from[1]));
  }
  return points;
}

/** Height at a point between the cells' centres; null beside the grid. Without heights: 0 on the grid. */
export function heightAt(grid: Grid, heights: Heights | null, [x, y]: Point): number | null {
  const cell = cellOf(grid);
  const u = (x - (grid.x_m[0] ?? 0)) / cell;
  const v = (y - (grid.y_m[0] ?? 0)) / cell;
  const [columns, rows] = [grid.x_m.length, grid.y_m.length];
  if (!(u >= -0.5 && u <= columns - 0.5 && v >= -0.5 && v <= rows - 0.5)) return null;
  if (heights === null) return 0;
  const column = Math.min(Math.max(Math.floor(u), 0), Math.max(columns - 2, 0));
  const row = Math.min(Math.max(Math.floor(v), 0), Math.max(rows - 2, 0));
  const [s, t] = [clamp(u - column), clamp(v - row)];
  const at = (r: number, c: number) =>
    heights[row + r]?.[column + c] ?? heights[row]?.[column] ?? 0;
  return (1 - t) * ((1 - s) * at(0, 0) + s * at(0, 1)) + t * ((1 - s) * at(1, 0) + s * at(1, 1));
}

/** As `heightAt`; beside and on walls, which are thinner than two cells, that of the nearest cell: their full height. */
function edgedHeightAt(grid: Grid, heights: Heights, [x, y]: Point): number | null {
  const height_m = heightAt(grid, heights, [x, y]);
  if (height_m === null) return null;
  const cell = cellOf(grid);
  const at = (row: number, column: number) => heights[row]?.[column] ?? height_m;
  const u = (x - (grid.x_m[0] ?? 0)) / cell;
  const v = (y - (grid.y_m[0] ?? 0)) / cell;
  const [column, row] = [Math.floor(u), Math.floor(v)];
  const corners = [
    at(row, column),
    at(row, column + 1),
    at(row + 1, column),
    at(row + 1, column + 1),
  ];
  if (Math.max(...corners) - Math.min(...corners) < WALL_SLOPE * cell) return height_m;
  return at(Math.round(v), Math.round(u));
}

const clamp = (value: number) => Math.min(Math.max(value, 0), 1);

export type SectionPoint = {
  /** From the middle of the place: to its front, or to its left. */
  at_m: number;
  start_m: number;
  now_m: number;
  /** Null beside the place. */
  wanted_m: number | null;
};

type Surfaces = Grid & { start_m: Heights; height_m: Heights; wanted_m: Heights };

/** The ground through the middle of a place, along its length or across it. */
export function section(
  surface: Surfaces,
  place: Rectangle,
  direction: "along" | "across",
): SectionPoint[] {
  const half_m = (direction === "along" ? place.length_m : place.width_m) / 2;
  const cell = cellOf(surface);
  // Half a cell, lest a wall stand between two points.
  const step_m = cell / 2;
  const count = Math.ceil((half_m + MARGIN_M) / step_m);
  const points: SectionPoint[] = [];
  for (let step = -count; step <= count; step += 1) {
    const at_m = step * step_m;
    const point = fromLocal(place, direction === "along" ? [at_m, 0] : [0, at_m]);
    const now_m = edgedHeightAt(surface, surface.height_m, point);
    const start_m = edgedHeightAt(surface, surface.start_m, point);
    if (now_m === null || start_m === null) continue;
    const isInside = Math.abs(at_m) <= half_m - cell / 2;
    const wanted_m = isInside ? heightAt(surface, surface.wanted_m, point) : null;
    points.push({ at_m: Number(at_m.toFixed(3)), start_m, now_m, wanted_m });
  }
  return points;
}

export const isWithin = (place: Rectangle, point: Point) => {
  const [along, across] = toLocal(place, point);
  return Math.abs(along) <= place.length_m / 2 && Math.abs(across) <= place.width_m / 2;
};
