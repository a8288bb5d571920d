import { describe, expect, it } from "vitest";
import {
  figureWords,
  letGoWords,
  missWords,
  type Shadow,
  type ShadowRun,
  type ShadowThrow,
  summaryWords,
  throwsWords,
} from "./shadow";

const predicted = (down: number | null, outcome = "landed") =>
  ({
    outcome,
    downrange_error_m: down,
    crossrange_error_m: down === null ? null : -down,
  }) as ShadowThrow["candidate"];

const thrown = (own: number | null, flown: number | null, shown: number | null = 1.04) =>
  ({
    throw_id: `t${own}${flown}`,
    flown_release_s: 1.12,
    shown_release_s: shown,
    candidate: predicted(own, own === null ? "no_release" : "landed"),
    flown: flown === null ? null : predicted(flown),
  }) as ShadowThrow;

describe("a version in shadow", () => {
  it("says when it would have let go", () => {
    expect(letGoWords(thrown(0.1, 0.1))).toBe("0.08 s sooner");
    expect(letGoWords(thrown(0.1, 0.1, 1.12))).toBe("same");
    expect(letGoWords(thrown(0.1, 0.1, null))).toBe("later");
  });

  it("says why a throw has no miss", () => {
    expect(missWords(thrown(null, 0.1).candidate)).toBe("no release");
    expect(missWords(null)).toBe("files gone");
    expect(missWords(thrown(0.123, 0.1).candidate)).toBe("+0.12, −0.12");
  });

  it("says what a run was about and what came of it", () => {
    const run = { machine_id: null, since_utc: null, until_utc: null } as ShadowRun;
    expect(throwsWords(run)).toBe("all machines");
    expect(throwsWords({ ...run, machine_id: "m001", since_utc: "2026-11-21T14:03:21Z" })).toMatch(
      /^m001, since 2026-11-2\d \d\d:03:21$/,
    );
    const misses = { throw_count: 3, landed_count: 2, mean_downrange_m: 0.2 };
    expect(figureWords({ ...misses, mean_crossrange_m: -0.014 })).toBe("+0.20, −0.01 (2 of 3)");
    const none = { throw_count: 3, landed_count: 0, mean_downrange_m: null };
    expect(figureWords({ ...none, mean_crossrange_m: null })).toBe("none lands (0 of 3)");
    expect(figureWords({ ...none, throw_count: 0, mean_crossrange_m: null })).toBe("files gone");
  });

  it("sums up by landed throws only", () => {
    const throws = [thrown(0.1, 0.02), thrown(0.3, 0.04), thrown(null, 0.06)];
    const found = { policy_id: "v8", throws } as unknown as Shadow;
    expect(summaryWords(found)).toBe(
      "v8 lands 2 of 3 times, on average +0.20 m long, −0.20 m right; what flew lands 3 of 3 times, on average +0.04 m long, −0.04 m right.",
    );
    const alone = { policy_id: "v8", throws: [thrown(null, null)] } as unknown as Shadow;
    expect(summaryWords(alone)).toBe("v8 never lands in the twin.");
  });
});
