import { describe, expect, it } from "vitest";
import { boxOf, footprint, labelPlaces, polygon, toYard, viewOf } from "./yardGeometry";

const close = (point: readonly number[], wanted: readonly number[]) => {
  expect(point.length).toBe(wanted.length);
  point.forEach((value, index) => {
    expect(value).toBeCloseTo(wanted[index] ?? Number.NaN, 9);
  });
};

describe("the plan of the yard", () => {
  it("turns a machine's points by its heading, to the left, and moves them to its place", () => {
    const place = { x_m: 10, y_m: -2, heading_rad: Math.PI / 2 };
    close(toYard(place, [0, 0]), [10, -2]);
    close(toYard(place, [5, 0]), [10, 3]);
    close(toYard(place, [0, 1]), [9, -2]);
  });

  it("keeps distances", () => {
    const place = { x_m: 3, y_m: 4, heading_rad: 0.7 };
    const [ax, ay] = toYard(place, [1, 2]);
    const [bx, by] = toYard(place, [-3, 5]);
    expect(Math.hypot(ax - bx, ay - by)).toBeCloseTo(5, 9);
  });

  it("gives an object's footprint about its centre, turned", () => {
    const truck = {
      name: "truck",
      kind: "box" as const,
      x_m: 9,
      y_m: 1,
      turn_rad: Math.PI / 2,
      length_m: 4,
      width_m: 2,
      height_m: 1,
      base_height_m: 0,
      top_ratio: 0,
    };
    const corners = footprint(truck);
    close(corners[0] ?? [], [8, 3]);
    close(corners[2] ?? [], [10, -1]);
  });

  it("fits everything into the picture with one scale, y up", () => {
    const box = boxOf([
      { at: [0, 0], radius_m: 10 },
      { at: [40, 5], radius_m: 10 },
    ]);
    expect(box).toEqual({ left_m: -10, right_m: 50, bottom_m: -10, top_m: 15 });
    if (!box) return;
    for (const [width, height] of [
      [900, 500],
      [340, 320],
    ] as const) {
      const view = viewOf(box, width, height);
      expect(view.x(box.left_m)).toBeGreaterThanOrEqual(28 - 1e-9);
      expect(view.x(box.right_m)).toBeLessThanOrEqual(width - 28 + 1e-9);
      expect(view.y(box.top_m)).toBeGreaterThanOrEqual(28 - 1e-9);
      expect(view.y(box.bottom_m)).toBeLessThanOrEqual(height - 28 + 1e-9);
      expect(view.y(1)).toBeLessThan(view.y(0));
      expect(view.x(1) - view.x(0)).toBeCloseTo(view.y(0) - view.y(1), 9);
    }
  });

  it("has no box of nothing, and a scale for a single point", () => {
    expect(boxOf([])).toBeNull();
    const box = boxOf([{ at: [2, 2], radius_m: 0 }]);
    expect(box && viewOf(box, 300, 200).scale).toBeGreaterThan(0);
  });

  it("writes a polygon in pixels", () => {
    const view = { scale: 2, x: (m: number) => 2 * m, y: (m: number) => 10 - 2 * m };
    expect(
      polygon(
        [
          [0, 0],
          [1, 2.5],
        ],
        view,
      ),
    ).toBe("0.0,10.0 2.0,5.0");
  });

  it("keeps labels in the picture and off each other", () => {
    const size = [200, 50] as const;
    const picture = [280, 500] as const;
    const labels = labelPlaces(
      [
        [55, 240],
        [135, 240],
        [215, 240],
      ],
      picture,
      size,
    );
    for (const [x, y] of labels) {
      expect(x - size[0] / 2).toBeGreaterThanOrEqual(0);
      expect(x + size[0] / 2).toBeLessThanOrEqual(picture[0]);
      expect(y + size[1]).toBeLessThanOrEqual(picture[1]);
    }
    const [first, second, third] = labels.map(([, y]) => y) as [number, number, number];
    expect(first).toBe(254);
    expect(second - first).toBeGreaterThanOrEqual(size[1]);
    expect(third - second).toBeGreaterThanOrEqual(size[1]);
    // Where there is room each stands under its own point.
    close(labelPlaces([[500, 90]], [1000, 400], size)[0] ?? [], [500, 104]);
  });
});
