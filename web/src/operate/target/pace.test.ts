import { expect, it } from "vitest";
import { DEFAULT_PACE_RATIO, paceWords } from "./pace";

it.each([
  [DEFAULT_PACE_RATIO, "0.00, careful"],
  [0.25, "0.25, careful"],
  [0.5, "0.50, balanced"],
  [1, "1.00, fast"],
])("a pace of %d is %s", (pace, words) => expect(paceWords(pace)).toBe(words));
