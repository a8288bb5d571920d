import { describe, expect, it } from "vitest";
import type { Difference } from "./useComparison";
import { differenceWords, quantityWords, valueWords, verdictWords } from "./words";

const row: Difference = {
  range_m: 9,
  height_m: 0,
  quantity: "mean down",
  a: 0.01,
  b: -0.02,
  difference: [-0.05, -0.01],
  verdict: "cannot tell",
  a_throw_count: 20,
  b_throw_count: 18,
};

describe("differences of two versions", () => {
  it("say where the throws cannot tell", () => {
    expect(verdictWords(row)).toBe("cannot tell from 20 and 18 throws");
    expect(verdictWords({ ...row, verdict: "worse" })).toBe("worse");
  });

  it("show each quantity in its own way", () => {
    expect(quantityWords("sd cross")).toBe("Spread across");
    expect(valueWords("landed", 0.95)).toBe("95.0 %");
    expect(valueWords("mean down", 0.01)).toBe("+0.010");
    expect(valueWords("sd down", 0.043)).toBe("0.043");
    expect(differenceWords(row)).toBe("\u22120.050 to \u22120.010");
    expect(differenceWords({ ...row, quantity: "sd down", difference: [0.8, 1.3] })).toBe(
      "0.80 to 1.30 times",
    );
    const spread: Difference = { ...row, quantity: "sd down", difference: [0.002, 370.5] };
    expect(differenceWords(spread)).toBe("any ratio");
    expect(differenceWords({ ...spread, verdict: "worse", difference: [12, 400] })).toBe(
      "12.00 to 400.00 times",
    );
    expect(differenceWords({ ...row, difference: null })).toBe("–");
  });
});
