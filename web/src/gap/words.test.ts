import { describe, expect, it } from "vitest";
import { chainOf } from "./result/chain";
import { overlaysOf } from "./result/plots";
import { refusedOf, ruledOutOf } from "./result/ruledOut";
import {
  additionWords,
  causeWords,
  comparedWords,
  type Diagnosis,
  doubtWords,
  newest,
  parameterWords,
  probabilityWords,
  type Run,
  shrinkWords,
  sizeWords,
} from "./words";

const found: Diagnosis = {
  verdict: "explained",
  sentence: "The dipper is late.",
  gap: { impact_rms_m: 0.4 },
  stages: [
    {
      stage: "actuation",
      joint: "boom",
      miss_m: { downrange: 0.1, crossrange: 0.02 },
      share_ratio: 0.2,
      ci90_m: [0.05, 0.15],
    },
    {
      stage: "actuation",
      joint: "dipper",
      miss_m: { downrange: -0.4, crossrange: 0 },
      share_ratio: 0.7,
      ci90_m: [-0.5, -0.3],
    },
    {
      stage: "flight",
      miss_m: { downrange: 0.03, crossrange: 0 },
      share_ratio: 0.1,
      ci90_m: [0, 0.06],
    },
  ],
  causes: [
    {
      effects: [
        {
          effect: "valve_dead_time",
          joint: "dipper",
          parameters: { extra_dead_time_s: { value: 0.062, ci90: [0.055, 0.07], unit: "s" } },
        },
      ],
      probability: 0.93,
      name: "valve dead time of the dipper",
    },
    { effects: [], probability: 0.07, name: "unknown" },
  ],
  evidence: { where: { stage: "actuation", joint: "dipper" } },
  plots: {},
};

describe("words of a diagnosis", () => {
  it("name causes with their joints", () => {
    expect(found.causes.map(causeWords)).toEqual(["valve dead time, dipper", "something unknown"]);
  });

  it("name a drift by what drifts", () => {
    const parameters = {
      "release_delay.extra_delay_s": {
        value: 0.07,
        ci90: [0.05, 0.1] as [number, number],
        unit: "s",
      },
    };
    const effects = [{ effect: "warm_up_drift", parameters }];
    expect(causeWords({ effects, probability: 0.5, name: "" })).toBe("drift of release delay");
    const ruledOut = [{ effect: "warm_up_drift:valve_lag.extra_lag_s", joint: "dipper" }];
    expect(ruledOutOf({ ruled_out: ruledOut })[0]?.name).toBe(
      "drift of valve lag, extra lag, dipper",
    );
  });

  it("give sizes in units a person would choose", () => {
    const size = (value: number, unit: string) =>
      sizeWords({ value, ci90: [value * 0.9, value * 1.1], unit }).value;
    expect(sizeWords({ value: 0.062, ci90: [0.055, 0.07], unit: "s" })).toEqual({
      value: "62.0 ms",
      interval: "55.0 to 70.0 ms",
    });
    expect(size(-0.02, "rad")).toBe("−20.0 mrad");
    expect(size(0.3, "1")).toBe("30.0 %");
    expect(size(2, "m/s")).toBe("2.00 m/s");
    expect(size(1.5, "s")).toBe("1.50 s");
  });

  it("leave units out of parameter names", () => {
    expect(parameterWords("extra_dead_time_s")).toBe("extra dead time");
    expect(parameterWords("half_width_ratio")).toBe("half width");
    expect(parameterWords("gap_rad_m")).toBe("gap");
    expect(parameterWords("valve_lag.extra_lag_s")).toBe("valve lag, extra lag");
  });

  it("are never quite certain", () => {
    expect([0.9999, 0.42, 1e-9].map(probabilityWords)).toEqual(["> 99 %", "42 %", "< 1 %"]);
  });

  it("say how far it shrinks, and on what that was measured", () => {
    const shrink = {
      before_m: 0.4,
      after_m: 0.1,
      ratio: 0.81,
      ci90: [0.7, 0.88] as [number, number],
      held_out_throws: 12,
      predicted_ratio: 0.85,
      removable_ratio: 0.9,
    };
    expect(shrinkWords(shrink, "impact")).toBe(
      "Removes 81 % of the removable gap on 12 held-out throws, 90 % interval 70 % to 88 %. Predicted before it was added: 85 %. 90 % of the gap is removable, the rest is noise and jitter. Both values are without the error that every healthy machine of the type has against its twin.",
    );
    const channels = shrinkWords({ ...shrink, predicted_ratio: null }, "channels");
    expect(channels).toContain("81 % of the gap in the channels that it moves");
    expect(channels).not.toContain("removable");
    const worse = { ...shrink, ratio: -0.89, ci90: [-1, -0.65] as [number, number] };
    expect(shrinkWords(worse, "impact")).toContain("Widens the removable gap by 89 %");
  });

  it("warn of a cause that held-out throws do not confirm", () => {
    const shrink = (ratio: number, low: number) =>
      ({ ratio, ci90: [low, 0.9], before_m: 1.25, after_m: 2, held_out_throws: 8 }) as never;
    expect(doubtWords({ ...found, shrink: shrink(0.8, 0.7) })).toBeNull();
    expect(doubtWords({ ...found, shrink: shrink(0.3, -0.1) })).toContain("do not show");
    expect(doubtWords({ ...found, shrink: shrink(-0.89, -1) })).toContain(
      "1.25 before, 2.00 after",
    );
    expect(doubtWords({ ...found, shrink: null })).toBeNull();
  });

  it("say what applying would add", () => {
    expect(additionWords(found)).toBe("Adds valve dead time, dipper: extra dead time 62.0 ms.");
    expect(additionWords({ ...found, causes: [] })).toBe("Adds nothing.");
  });
});

describe("a run", () => {
  const row = (state: Run["state"], progress_ratio = 0) =>
    ({ gap_run_id: "g1", state, progress_ratio }) as Run;

  it("follows events while it is open, and is what was asked for once it ended", () => {
    const events = { g1: row("running", 0.5) };
    expect(newest(row("queued"), events).progress_ratio).toBe(0.5);
    expect(newest(row("running"), {}).progress_ratio).toBe(0);
    expect(newest(row("done"), events).state).toBe("done");
    expect(newest(row("running"), { g1: row("done") }).state).toBe("done");
  });
});

describe("what a run was compared with", () => {
  it("is the type, or throws of the machine itself", () => {
    const row = (reference_throw_count: number) => ({ reference_throw_count }) as Run;
    expect(comparedWords(row(0))).toBe("healthy machines of the type");
    expect(comparedWords(row(24))).toBe("24 healthy throws of this machine");
  });
});

describe("the chain", () => {
  it("has every stage in its order, sums of joints, and the place of the cause", () => {
    const chain = chainOf(found);
    expect(chain.links.map((link) => link.stage)).toEqual([
      "actuation",
      "swing",
      "release",
      "flight",
      "aim",
    ]);
    expect(chain.links[0]?.downrange_m).toBeCloseTo(-0.3);
    expect(chain.links[0]?.terms.map((term) => term.joint)).toEqual(["boom", "dipper"]);
    expect(chain.links.map((link) => link.here)).toEqual(["cause", "", "", "", ""]);
    const healthy = chainOf({ ...found, verdict: "none" });
    expect(healthy.links[0]?.here).toBe("largest");
    // Whatever would come nearest to a cause: what adds most is what adds most.
    const aimed = { ...found, verdict: "none" as const, evidence: { where: { stage: "aim" } } };
    expect(chainOf(aimed).links.map((link) => link.here)).toEqual(["largest", "", "", "", ""]);
    expect(chain.links[1]?.terms).toEqual([]);
    expect(chain.limit_m).toBe(0.5);
    expect(chain.isMetric).toBe(true);
  });

  it("of a single stage has no metres", () => {
    const alone = {
      stage: "swing" as const,
      miss_m: { downrange: 0, crossrange: 0 },
      share_ratio: 1,
      ci90_m: [0, 0] as [number, number],
    };
    const chain = chainOf({ ...found, stages: [alone], evidence: {} });
    expect(chain.isMetric).toBe(false);
    expect(chain.links.some((link) => link.here)).toBe(false);
  });
});

describe("overlays", () => {
  it("know measured, before and after under their names, and what is left", () => {
    const [overlay, ...rest] = overlaysOf({
      t1_dipper: {
        x: [0, 1, 2],
        unit: "rad/s",
        measured: [1, 2, null],
        ideal: [0, 1, 2],
        explained: [1, 2, 3],
        other: [1],
      },
      empty: { x: [], measured: [] },
      odd: "text",
    });
    expect(rest).toEqual([]);
    expect(overlay?.name).toBe("t1 dipper");
    expect(overlay?.group).toBe("t1 dipper");
    expect(overlay?.lines.map((line) => line.label)).toEqual(["measured", "before", "after"]);
    expect(overlay?.left.map((line) => line.values)).toEqual([
      [1, 1, null],
      [0, 0, null],
    ]);
  });
});

describe("reasons", () => {
  it("are read from evidence, whatever else stands there", () => {
    const evidence = {
      ruled_out: [{ effect: "wind", joint: null, log_odds: -4.25 }, "text", null],
      refused: [{ path: "/data/throws/a.mcap", reason: "10 Hz" }],
    };
    expect(ruledOutOf(evidence)).toEqual([
      { name: "wind", why: "natural log odds −4.3 against no effect" },
    ]);
    expect(refusedOf(evidence)).toEqual([{ name: "a.mcap", why: "10 Hz" }]);
    expect(ruledOutOf({})).toEqual([]);
  });
});
