/**
 * Geometry of the yard's plan. Frame `yard`: metres, x to the right, y up. Points of a machine are in its
 * frame `machine`: x ahead, y to the left.
 */

import type { Schema } from "../session/client";

export type Point = readonly [x_m: number, y_m: number];
export type Place = Pick<Schema["PlaceView"], "x_m" | "y_m" | "heading_rad">;
export type SiteObject = Schema["SiteObject"];
export type Box = { left_m: number; right_m: number; bottom_m: number; top_m: number };

/** Pixels from metres: one scale for both axes, y up. */
export type PlanView = { scale: number; x: (x_m: number) => number; y: (y_m: number) => number };

/** A point of a machine on the plan. */
export function toYard(place: Place, [x_m, y_m]: Point): Point {
  const cos = Math.cos(place.heading_rad);
  const sin = Math.sin(place.heading_rad);
  return [place.x_m + cos * x_m - sin * y_m, place.y_m + sin * x_m + cos * y_m];
}

/** Corners of an object's footprint, frame `machine`. */
export function footprint(object: SiteObject): Point[] {
  const { x_m, y_m, turn_rad = 0, length_m, width_m } = object;
  const own: Place = { x_m, y_m, heading_rad: turn_rad };
  const [along, across] = [length_m / 2, width_m / 2];
  return [
    toYard(own, [along, across]),
    toYard(own, [-along, across]),
    toYard(own, [-along, -across]),
    toYard(own, [along, -across]),
  ];
}

/** The smallest box that holds circles about points; null of none. */
export function boxOf(circles: readonly { at: Point; radius_m: number }[]): Box | null {
  if (circles.length === 0) return null;
  const box = {
    left_m: Number.POSITIVE_INFINITY,
    right_m: Number.NEGATIVE_INFINITY,
    bottom_m: Number.POSITIVE_INFINITY,
    top_m: Number.NEGATIVE_INFINITY,
  };
  for (const {
    at: [x_m, y_m],
    radius_m,
  } of circles) {
    box.left_m = Math.min(box.left_m, x_m - radius_m);
    box.right_m = Math.max(box.right_m, x_m + radius_m);
    box.bottom_m = Math.min(box.bottom_m, y_m - radius_m);
    box.top_m = Math.max(box.top_m, y_m + radius_m);
  }
  return box;
}

/** The largest view of a box that fits a picture, with a margin, in its middle. */
export function viewOf(box: Box, width: number, height: number, margin = 28): PlanView {
  const wide_m = Math.max(box.right_m - box.left_m, 1);
  const high_m = Math.max(box.top_m - box.bottom_m, 1);
  const inner = (length: number) => Math.max(length - 2 * margin, 1);
  const scale = Math.min(inner(width) / wide_m, inner(height) / high_m);
  const middle_x = (box.left_m + box.right_m) / 2;
  const middle_y = (box.bottom_m + box.top_m) / 2;
  return {
    scale,
    x: (x_m) => width / 2 + (x_m - middle_x) * scale,
    y: (y_m) => height / 2 - (y_m - middle_y) * scale,
  };
}

export type Pixels = readonly [x: number, y: number];

/**
 * Top middle of a label under each point, in pixels: inside the picture, and below the labels of points before
 * it where they would lie on each other.
 */
export function labelPlaces(
  points: readonly Pixels[],
  [width, height]: Pixels,
  label: Pixels,
  gap = 14,
): Pixels[] {
  const half = Math.min(label[0], width) / 2;
  const placed: Pixels[] = [];
  for (const [point_x, point_y] of points) {
    const x = Math.min(Math.max(point_x, half), width - half);
    const overlapped = (y: number) =>
      placed.filter(
        ([other_x, other_y]) =>
          Math.abs(other_x - x) < label[0] && Math.abs(other_y - y) < label[1],
      );
    let y = point_y + gap;
    for (let over = overlapped(y); over.length > 0; over = overlapped(y))
      y = Math.max(...over.map(([, other_y]) => other_y)) + label[1];
    placed.push([x, Math.max(0, Math.min(y, height - label[1]))]);
  }
  return placed;
}

/** Points of an SVG polygon. */
export const polygon = (corners: readonly Point[], view: PlanView) =>
  corners.map(([x, y]) => `${view.x(x).toFixed(1)},${view.y(y).toFixed(1)}`).join(" ");
