import { describe, expect, it } from "vitest";
import { azimuthOf, isSameSite, newObject, placed, placeWords, rangeOf, topOf } from "./objects";

describe("objects of a site", () => {
  it("are new at the target, turned to the machine, with a free name", () => {
    const first = newObject("box", [], { x_m: 0, y_m: 8 });
    const second = newObject("box", [first], null);
    expect([first.name, second.name]).toEqual(["box 1", "box 2"]);
    expect(first.turn_rad).toBeCloseTo(Math.PI / 2);
    expect([second.x_m, second.y_m, second.turn_rad]).toEqual([9, 0, 0]);
  });

  it("move by range and azimuth", () => {
    const moved = placed(newObject("pit", [], null), 8, -0.5);
    expect(rangeOf(moved)).toBeCloseTo(8);
    expect(azimuthOf(moved)).toBeCloseTo(-0.5);
  });

  it("say where loads lie on them", () => {
    const pit = newObject("pit", [], { x_m: 9, y_m: 0 });
    expect(topOf(pit)).toBe(-0.8);
    expect(placeWords(pit)).toBe("9.0 m, 0.0° ahead, floor \u22120.80 m");
    const platform = { ...newObject("box", [], null), base_height_m: 2 };
    expect(placeWords(platform)).toContain("top +3.20 m");
  });

  it("are compared by what they say", () => {
    const box = newObject("box", [], null);
    expect(isSameSite([box], [{ ...box }])).toBe(true);
    expect(isSameSite([box], [{ ...box, height_m: 2 }])).toBe(false);
  });
});
