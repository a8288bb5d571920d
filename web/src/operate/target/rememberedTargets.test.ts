import { expect, test } from "vitest";
import { NONE_SAVED, RECENT_COUNT, withName, withoutName, withRecent } from "./rememberedTargets";
import { fromPolar } from "./target";

const at = (range_m: number) => fromPolar(range_m, 0, 0);

test("the last targets are kept, newest first and each once", () => {
  let all = NONE_SAVED;
  for (const range_m of [5, 6, 7, 8, 9, 10, 9]) all = withRecent(all, at(range_m));
  expect(all.recent).toHaveLength(RECENT_COUNT);
  expect(all.recent.map((one) => one.x_m)).toEqual([9, 10, 8, 7, 6]);
});

test("a name holds one place, and is forgotten alone", () => {
  const two = withName(withName(NONE_SAVED, "truck", at(9)), "pit", at(8));
  expect(two.named.map((one) => one.name)).toEqual(["pit", "truck"]);
  const moved = withName(two, "truck", at(7));
  expect(moved.named.find((one) => one.name === "truck")?.x_m).toBe(7);
  expect(withoutName(moved, "truck").named.map((one) => one.name)).toEqual(["pit"]);
});
