import { describe, expect, it } from "vitest";
import type { GateCheck, Validation } from "./useValidation";
import { estimateWords, gateNumber, limitWords, validationWords } from "./words";

const check: GateCheck = {
  gate: "sd_downrange",
  name: "Spread along",
  value: 0.0432,
  ci95: [0.03, 0.07],
  limit: 0.15,
  unit: "m",
  is_minimum: false,
  where: "virtual machine 0",
  is_passed: true,
};

describe("words of validations", () => {
  it("gives every gate its unit", () => {
    expect(gateNumber(0.0432, "m")).toBe("0.043 m");
    expect(gateNumber(0.989, "ratio")).toBe("98.9 %");
    expect(gateNumber(0.00006, "s")).toBe("0.06 ms");
    expect(gateNumber(1.04, "times")).toBe("1.04 times");
    expect(gateNumber(null, "m")).toBe("–");
    expect(limitWords(check)).toBe("at most 0.150 m");
    expect(limitWords({ ...check, unit: "ratio", limit: 0.99, is_minimum: true })).toBe(
      "at least 99.0 %",
    );
  });

  it("puts the interval beside the number", () => {
    expect(estimateWords({ value: 0.043, ci95: [0.03, 0.07] }, false)).toBe(
      "0.043 (0.030 to 0.070)",
    );
    expect(estimateWords({ value: -0.01, ci95: [-0.02, 0.01] }, true)).toBe(
      "\u22120.010 (\u22120.020 to +0.010)",
    );
    expect(estimateWords({ value: null, ci95: null }, true)).toBe("–");
  });

  it("counts the gates", () => {
    const done = (checks: GateCheck[]) =>
      validationWords({ state: "done", result: { checks } } as Validation);
    expect(done([check, check])).toBe("Passed all 2 gates");
    expect(done([check, { ...check, is_passed: false }])).toBe("1 of 2 gates not passed");
    expect(validationWords({ state: "failed", detail: "no files" } as Validation)).toContain(
      "no files",
    );
  });
});
