/** Rectangles on the ground, turned about their centres. */

/** x forward, y to the left of the machine, m. */
export type Point = readonly [number, number];

export type Rectangle = {
  x_m: number;
  y_m: number;
  length_m: number;
  width_m: number;
  /** Angle of its length from the x axis, positive to the left. */
  turn_rad?: number;
};

/** A point given along a rectangle's length and across it, from its centre. */
export function fromLocal(place: Rectangle, [along, across]: Point): Point {
  const [cos, sin] = [Math.cos(place.turn_rad ?? 0), Math.sin(place.turn_rad ?? 0)];
  return [place.x_m + cos * along - sin * across, place.y_m + sin * along + cos * across];
}

/** Coordinates of a point along a rectangle's length and across it, from its centre. */
export function toLocal(place: Rectangle, [x, y]: Point): Point {
  const [cos, sin] = [Math.cos(place.turn_rad ?? 0), Math.sin(place.turn_rad ?? 0)];
  const [dx, dy] = [x - place.x_m, y - place.y_m];
  return [cos * dx + sin * dy, cos * dy - sin * dx];
}

/** Its four corners, in the order in which one walks around. */
export function cornersOf(place: Rectangle): readonly Point[] {
  const [a, b] = [place.length_m / 2, place.width_m / 2];
  return (
    [
      [a, b],
      [-a, b],
      [-a, -b],
      [a, -b],
    ] as const
  ).map((corner) => fromLocal(place, corner));
}
