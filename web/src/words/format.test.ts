import { describe, expect, it } from "vitest";
import {
  age,
  bearingWords,
  bytes,
  count,
  crossrangeWords,
  degrees,
  downrangeWords,
  fixed,
  heightWords,
  metres,
  signed,
  unbroken,
} from "./format";

describe("errors carry a sign and a word", () => {
  it("says long and short along the target line", () => {
    expect(downrangeWords(0.124)).toBe("+0.12 m long");
    expect(downrangeWords(-0.076)).toBe("−0.08 m short");
    expect(downrangeWords(0.004)).toBe("0.00 m on range");
    expect(downrangeWords(-0.004)).toBe("0.00 m on range");
  });

  it("says left for positive crossrange, as frame throw does", () => {
    expect(crossrangeWords(0.05)).toBe("+0.05 m left");
    expect(crossrangeWords(-0.05)).toBe("−0.05 m right");
    expect(crossrangeWords(0)).toBe("0.00 m on line");
  });

  it("never rounds a word away from its number", () => {
    expect(downrangeWords(0.005)).toMatch(/long$/);
    expect(downrangeWords(0.0049)).toBe("0.00 m on range");
  });
});

describe("numbers", () => {
  it("has no negative zero", () => {
    expect(fixed(-0.001)).toBe("0.00");
    expect(signed(0.001)).toBe("0.00");
  });

  it("shows a dash for what is unknown", () => {
    for (const value of [null, undefined, Number.NaN, Number.POSITIVE_INFINITY]) {
      expect(metres(value)).toBe("–");
      expect(downrangeWords(value)).toBe("–");
    }
  });

  it("turns radians into degrees and bearings", () => {
    expect(degrees(Math.PI / 2)).toBe("90.0°");
    expect(bearingWords(-Math.PI / 6)).toBe("30.0° right");
    expect(bearingWords(0)).toBe("0.0° ahead");
    expect(heightWords(1.2)).toBe(", +1.20 m high");
    expect(heightWords(-0.8, " · ")).toBe(" · 0.80 m deep");
    expect(heightWords(0)).toBe("");
  });

  it("keeps ages coarse", () => {
    expect(age(14.9)).toBe("14 s");
    expect(age(-2)).toBe("0 s");
    expect(age(600)).toBe("10 min");
    expect(age(7200)).toBe("2 h");
    expect(age(200_000)).toBe("2 d");
  });

  it("counts with the noun", () => {
    expect(count(1, "throw")).toBe("1 throw");
    expect(count(12345, "throw")).toBe("12,345 throws");
    expect(bytes(1_234_567)).toBe("1.2 MB");
  });
});

describe("sentences", () => {
  it("keep numbers and their units on one line", () => {
    expect(unbroken("misses by 0.73 m (94 % sure): 75.1 ms on 12 throws at 3 m/s")).toBe(
      "misses by 0.73\u00a0m (94\u00a0% sure): 75.1\u00a0ms on 12 throws at 3\u00a0m/s",
    );
    expect(unbroken("12 more")).toBe("12 more");
    expect(unbroken("last seen 2 h ago, 5 d")).toBe("last seen 2\u00a0h ago, 5\u00a0d");
    expect(unbroken("at most 1.20 times")).toBe("at most 1.20\u00a0times");
  });
});
