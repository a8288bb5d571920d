import { expect, it } from "vitest";
import type { Plan } from "../session/live";
import { toCommit_s } from "./throwTimes";

const plan = { prediction: { release_s: 4.5 } } as Plan;

it("counts down to the predicted release and no further", () => {
  expect(toCommit_s("aligning", plan, 1)).toBeCloseTo(3.5, 9);
  expect(toCommit_s("throwing", plan, 5)).toBe(0);
});

it("ends where the machine says that it is committed", () => {
  expect(toCommit_s("committed", plan, 1)).toBeNull();
  expect(toCommit_s("settling", plan, 9)).toBeNull();
});

it("knows nothing without a prediction", () => {
  expect(toCommit_s("throwing", null, 1)).toBeNaN();
});
