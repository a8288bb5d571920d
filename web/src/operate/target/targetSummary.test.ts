import { describe, expect, it } from "vitest";
import type { Target } from "./target";
import { targetSummary } from "./targetSummary";

const at = (z_m: number) => ({ range_m: 8.5, azimuth_rad: 0, z_m }) as Target;

describe("the target in one line", () => {
  it("breaks between its parts only, after the dot", () => {
    const text = targetSummary("2d", at(1.2));
    expect(text.split(" ")).toEqual([
      "2D\u00a0·",
      "8.50\u00a0m\u00a0·",
      "0.0°\u00a0ahead\u00a0·",
      "+1.20\u00a0m\u00a0high",
    ]);
  });

  it("has no height on the ground, and only the mode without a target", () => {
    expect(targetSummary("3d", at(0)).replaceAll("\u00a0", " ")).toBe("3D · 8.50 m · 0.0° ahead");
    expect(targetSummary("3d", null)).toBe("3D");
  });
});
