import { describe, expect, it } from "vitest";
import {
  boxOf,
  type Drawing,
  forceWords,
  isComplete,
  newZone,
  withClick,
  type Zones,
  zoneWords,
} from "./zones";

const draw = (tool: Drawing["tool"], ...clicks: [number, number][]) =>
  clicks.reduce<Drawing>((drawing, [x, y]) => withClick(drawing, x, y), { tool, corners: [] });

describe("drawing a zone", () => {
  it("takes a box from two opposite corners", () => {
    expect(isComplete(draw("box", [1, 2]))).toBe(false);
    const box = draw("box", [1, 2], [3.00049, -1]);
    expect(isComplete(box)).toBe(true);
    expect(box.corners).toEqual(boxOf([1, 2], [3, -1]));
  });

  it("ignores a second corner that makes no box", () => {
    expect(draw("box", [1, 2], [1.05, 8]).corners).toEqual([[1, 2]]);
  });

  it("takes a polygon click by click, up to 24 corners", () => {
    const clicks = Array.from({ length: 30 }, (_, i): [number, number] => [i, i * i]);
    expect(draw("polygon", ...clicks).corners).toHaveLength(24);
    expect(isComplete(draw("polygon", ...clicks))).toBe(false);
  });

  it("takes a double tap as one corner", () => {
    expect(draw("polygon", [1, 2], [1.04, 2.04], [4, 2], [4, 2]).corners).toEqual([
      [1, 2],
      [4, 2],
    ]);
  });

  it("names zones that are new", () => {
    const corners = boxOf([1, 2], [3, 4]);
    const first = newZone(corners, []);
    expect(newZone(corners, [{ ...first, name: "ZONE 1" }]).name).toBe("zone 2");
    expect(zoneWords(first)).toBe("4 corners, 0.0 m to 3.0 m");
  });
});

describe("what is in force", () => {
  const zones = {
    approved_version_count: 3,
    approved_sha256: "a",
    approved: [{}],
    approved_by: "sue",
  } as unknown as Zones;

  it("says who approved it and whether the machine has it", () => {
    expect(forceWords(zones, "a", "m001")).toBe(
      "1 zone is in force (version 3, approved by sue). m001 has them.",
    );
    for (const other of ["", null, undefined])
      expect(forceWords(zones, other, "m001")).toMatch(/does not have them yet, and does not arm/);
    expect(forceWords({ ...zones, approved_version_count: 0 }, "", "m001")).toMatch(/^None is/);
  });
});
