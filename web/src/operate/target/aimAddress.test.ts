import { expect, test } from "vitest";
import { aimSearch, parseAim, targetOf } from "./aimAddress";
import { fromPolar } from "./target";

test("an address holds machine, mode and target, and gives them back", () => {
  const aim = aimSearch("m002", "3d", fromPolar(9.254, 0.1, 1.2));
  expect(aim).toEqual({ machine: "m002", mode: "3d", range: 9.25, azimuth: 5.73, height: 1.2 });
  const texts = Object.fromEntries(Object.entries(aim).map(([key, value]) => [key, String(value)]));
  expect(parseAim(texts)).toEqual(aim);
  const target = targetOf(parseAim(texts));
  expect(target?.range_m).toBeCloseTo(9.25);
  expect(target?.z_m).toBe(1.2);
});

test("a pace outside of 0 to 1 is left out", () => {
  expect(parseAim({ pace: "0.5" }).pace).toBe(0.5);
  expect(parseAim({ pace: 1.2 })).toEqual({});
});

test("a target on the ground needs no height, and none no range", () => {
  expect(aimSearch("m001", "2d", fromPolar(9, 0, 0))).not.toHaveProperty("height");
  expect(aimSearch("m001", "2d", null)).toEqual({ machine: "m001", mode: "2d" });
  expect(targetOf({ machine: "m001" })).toBeNull();
});

test.each([{ range: "far" }, { range: 0.1 }, { range: 1e9 }, { range: "" }, { azimuth: 5 }])(
  "what cannot be read is left out: %o",
  (search) => expect(parseAim({ ...search, mode: "4d", machine: "" })).toEqual({}),
);
