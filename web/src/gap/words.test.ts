import { describe, expect, it } from "vitest";
import { chainOf } from "./result/chain";
import { overlaysOf } from "./result/plots";
import { refusedOf } from "./result/refused";
import { additionWords, type Diagnosis, doubtWords, newest, type Run, usualWords } from "./words";

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

  it("say how long earlier ones took, and guess nothing", () => {
    const took = (usual_s: [number, number] | null) => usualWords({ usual_s } as Run);
    expect(took([23.6, 39.2])).toBe("The last ones like it took 24 to 39 s.");
    expect(took([24.1, 23.9])).toBe("The last one like it took 24 s.");
    expect(took(null)).toBe("No earlier one tells how long it takes.");
  });

  it("say what applying would add", () => {
    const words = { causes: [], ruled_out: [], undecided: "", shrink: "", facts: [], action: "" };
    const sizes = [{ name: "extra dead time", value: "62.0 ms", interval: "55.0 to 70.0 ms" }];
    const effects = [{ title: "valve dead time, dipper", sizes }];
    const causes = [{ title: "valve dead time, dipper", probability: "93 %", effects }];
    expect(additionWords({ ...words, causes })).toBe(
      "Adds valve dead time, dipper: extra dead time 62.0 ms.",
    );
    expect(additionWords(words)).toBe("Adds nothing.");
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
        throw_id: "t1",
        thrown_utc: "2026-05-01T10:00:00Z",
      },
      empty: { x: [], measured: [] },
      odd: "text",
    });
    expect(rest).toEqual([]);
    expect(overlay?.name).toBe("t1 dipper");
    expect(overlay?.group).toBe("t1 dipper");
    expect([overlay?.throwId, overlay?.thrownUtc]).toEqual(["t1", "2026-05-01T10:00:00Z"]);
    expect(overlay?.lines.map((line) => line.label)).toEqual(["measured", "before", "after"]);
    expect(overlay?.left.map((line) => line.values)).toEqual([
      [1, 1, null],
      [0, 0, null],
    ]);
  });
});

describe("refused logs", () => {
  it("are read from evidence, whatever else stands there", () => {
    const evidence = { refused: [{ path: "/data/throws/a.mcap", reason: "10 Hz" }, "text", null] };
    expect(refusedOf(evidence)).toEqual([{ name: "a.mcap", why: "10 Hz" }]);
    expect(refusedOf({})).toEqual([]);
  });
});
