import { describe, expect, it } from "vitest";
import { changesOf, consequence, figureWords, parseStages } from "./rolloutWords";
import type { Rollout } from "./useRollouts";

const rollout = (state: Rollout["state"], stage_count = 0) =>
  ({ state, stage_count, stages: [{}, {}], policy_id: "v8" }) as unknown as Rollout;

describe("words of rollouts", () => {
  it("reads a stage a line, with machines and tags", () => {
    expect(parseStages("m001\n\n m002, tag:yard ,\n")).toEqual([
      { machine_ids: ["m001"], tags: [] },
      { machine_ids: ["m002"], tags: ["yard"] },
    ]);
    expect(parseStages(" \n,")).toEqual([]);
  });

  it("offers what the state allows, with what follows", () => {
    expect(changesOf(rollout("running"))).toEqual(["pause", "promote", "abort"]);
    expect(changesOf(rollout("paused"))).toEqual(["resume", "promote", "abort"]);
    expect(changesOf(rollout("rolled_back"))).toEqual([]);
    expect(consequence("promote", rollout("running"))).toContain("next stage begins");
    expect(consequence("promote", rollout("running", 1))).toContain("is completed");
    expect(consequence("abort", rollout("running"))).toContain("previewed with v8");
  });

  it("puts intervals beside numbers, and nothing where nothing was thrown", () => {
    const one = { value: 0.05, ci95: [0.04, 0.07] as [number, number] };
    const figures = {
      throw_count: 12,
      mean_downrange_error_m: one,
      sd_downrange_m: one,
      mean_crossrange_error_m: one,
      sd_crossrange_m: one,
    };
    expect(figureWords(figures, "downrange")).toBe(
      "mean +0.050 (+0.040 to +0.070), sd 0.050 (0.040 to 0.070)",
    );
    expect(figureWords({ ...figures, throw_count: 0 }, "downrange")).toBe("–");
    expect(figureWords(null, "crossrange")).toBe("–");
  });
});
