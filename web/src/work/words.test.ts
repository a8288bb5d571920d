import { describe, expect, it } from "vitest";
import type { Job } from "./job";
import { courseOf, figures, landedWords, leftWords, noPlanWords, reasonWords } from "./words";

const LOAD = {
  load_count: 1,
  throw_id: null,
  x_m: 8,
  y_m: 1,
  volume_m3: 0.25,
  spread_m: null,
  landed_by: "measured",
  recorded_by: "eve",
  at_utc: "2026-11-27T09:00:00Z",
  is_withdrawn: false,
  filled_ratio: 0.1,
  spill_ratio: 0.02,
} as Job["loads"][number];

const JOB = {
  progress: { filled_ratio: 0.345, missing_m3: 3.2, spill_ratio: 0.004, unevenness_m: 0.121 },
  thrown_m3: 0.25,
  loads_per_s: 40 / 3600,
  time_left_s: 1500,
  plan_state: "ready",
  plan_error: null,
  loads: [LOAD, { ...LOAD, load_count: 2, is_withdrawn: true }],
} as unknown as Job;

describe("figures", () => {
  it("count what lies there, not what was taken back", () => {
    const of = Object.fromEntries(figures(JOB).map(({ name, value }) => [name, value]));
    expect(of).toMatchObject({
      Filled: "34.5 %",
      Spilled: "0.4 %",
      "Thrown in 1 load": "0.25 m³",
      "Loads per hour": "40",
      "Time left, about": "25 min",
    });
  });

  it("say nothing before anybody can know", () => {
    const early = figures({ ...JOB, loads_per_s: null, time_left_s: null });
    expect(early.slice(-2).map(({ value }) => value)).toEqual(["–", "–"]);
  });

  it("round the time left", () => {
    expect(leftWords(20)).toBe("1 min");
    expect(leftWords(7200)).toBe("2 h");
    expect(leftWords(7800)).toBe("2 h 10 min");
    expect(leftWords(7190 + 3500)).toBe("3 h");
  });
});

describe("without a proposal", () => {
  it("the reason comes with what to do", () => {
    expect(noPlanWords(JOB)).toBeNull();
    expect(noPlanWords({ ...JOB, plan_state: "nothing_left" })).toContain("End the job");
    const failed = { ...JOB, plan_state: "failed", plan_error: "out of reach" } as Job;
    expect(noPlanWords(failed)).toMatch(/^Out of reach\. Upload a survey/);
  });
});

describe("a reason", () => {
  it("keeps its numbers with their units", () => {
    expect(reasonWords("left rear: 0.30 m3 missing; spill risk 0.4 %")).toBe(
      "left rear: 0.30\u00a0m³ missing; spill risk 0.4\u00a0%",
    );
    expect(reasonWords("y -0.4 m; left-rear, -1.7 s")).toBe(
      "y −0.4\u00a0m; left-rear, −1.7\u00a0s",
    );
  });
});

describe("where a load landed", () => {
  it("tells how it lies where that was measured", () => {
    expect(landedWords(LOAD)).toBe("measured");
    const spread = landedWords({ ...LOAD, spread_m: [0.5, 0.41] });
    expect(spread).toMatch(/^measured, spread 0\.50 × 0\.41\sm \(1σ\)$/);
  });
});

describe("the course", () => {
  it("begins empty and leaves out loads that were taken back", () => {
    expect(courseOf(JOB)).toEqual([
      { load: 0, filled: 0, spilled: 0 },
      { load: 1, filled: 10, spilled: 2 },
    ]);
  });
});
