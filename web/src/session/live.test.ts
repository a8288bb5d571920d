import { describe, expect, it } from "vitest";
import {
  EMPTY_LIVE,
  type GapRun,
  type Live,
  type Machine,
  type Plan,
  reduceLive,
  type ServerEvent,
  type Throw,
} from "./live";

function machine(change: Partial<Machine> = {}): Machine {
  return {
    machine_id: "m001",
    site: "yard",
    name: "",
    lamp: "disarmed",
    lamp_text: "disarmed",
    link: {
      is_connected: true,
      last_seen_utc: "2026-11-21T12:00:00.123456Z",
      last_seen_age_s: 0.01,
      round_trip_s: 0.00421,
      state_rate_hz: 9.97,
    },
    lease: {
      machine_id: "m001",
      epoch_count: 1,
      holder: null,
      holder_session_id: null,
      acquired_utc: null,
      expires_utc: null,
      idle_release_utc: null,
    },
    state: null,
    reach: { static_reach_m: 7.5, modes: [] },
    target: null,
    unknown_throw_id: null,
    is_stop_pending: false,
    ...change,
  } as Machine;
}

const target = { x_m: 9, y_m: 0, z_m: 0, range_m: 9, azimuth_rad: 0 };
const plan = (id: string, state: Plan["state"]) => ({ plan_id: id, state }) as Plan;
const loaded = reduceLive(EMPTY_LIVE, { kind: "resync", machines: [machine()] });
const event = (live: Live, ev: ServerEvent, sessionId = "me") =>
  reduceLive(live, { kind: "event", event: ev, sessionId });
const proposed = (session_id: string, refusal = "", point: typeof target | null = target) =>
  ({
    kind: "target.proposed",
    machine_id: "m001",
    session_id,
    target: point,
    source: "pick",
    refusal,
  }) as const;

describe("resync", () => {
  it("replaces what was known: a machine that is gone is gone", () => {
    const other = reduceLive(loaded, { kind: "resync", machines: [machine({ machine_id: "m2" })] });
    expect(Object.keys(other.machines)).toEqual(["m2"]);
    expect(other.isLoaded).toBe(true);
  });
});

describe("machine.state", () => {
  it("keeps our target, which broadcasts do not carry", () => {
    const aimed = event(loaded, proposed("me"));
    const next = event(aimed, { kind: "machine.state", machine: machine({ lamp: "armed" }) });
    expect(next.machines.m001).toMatchObject({ lamp: "armed", target });
  });

  it("changes nothing when only clocks moved on", () => {
    const later = machine();
    later.link = { ...later.link, last_seen_utc: "2026-11-21T12:00:00.923Z", last_seen_age_s: 0.2 };
    const next = event(loaded, { kind: "machine.state", machine: later });
    expect(next).toBe(loaded);
  });

  it("adds a machine that appears", () => {
    const next = event(loaded, { kind: "machine.state", machine: machine({ machine_id: "m2" }) });
    expect(Object.keys(next.machines)).toEqual(["m001", "m2"]);
  });
});

describe("machine.lost", () => {
  it("keeps the machine and says since when", () => {
    const last_seen_utc = "2026-11-21T12:00:05Z";
    const next = event(loaded, {
      kind: "machine.lost",
      machine_id: "m001",
      last_seen_utc,
      detail: "",
    });
    expect(next.machines.m001).toMatchObject({
      lamp: "lost",
      link: { is_connected: false, last_seen_utc },
    });
  });

  it("of an unknown machine is no machine", () => {
    const next = event(loaded, {
      kind: "machine.lost",
      machine_id: "mX",
      last_seen_utc: null,
      detail: "",
    });
    expect(next.machines).toBe(loaded.machines);
  });
});

describe("machine.retired", () => {
  it("takes the machine, and no other, out of the fleet", () => {
    const next = event(loaded, { kind: "machine.retired", machine_id: "m001" });
    expect(Object.keys(next.machines)).toEqual(
      Object.keys(loaded.machines).filter((id) => id !== "m001"),
    );
    expect(event(next, { kind: "machine.retired", machine_id: "m001" }).machines).toEqual(
      next.machines,
    );
  });
});

describe("target.proposed", () => {
  it("an echo of an older target does not take back what is typed meanwhile", () => {
    const typed = { ...target, range_m: 14 };
    const kind = "target" as const;
    const asked = reduceLive(loaded, { kind, machineId: "m001", target: typed, isProposing: true });
    const echo = { ...proposed("me"), source: "fields" } as const;
    expect(event(asked, echo).machines.m001?.target).toEqual(typed);
    expect(event(asked, proposed("me")).machines.m001?.target).toEqual(target);
    const sent = reduceLive(asked, { kind: "target_sent", machineId: "m001" });
    expect(event(sent, echo).machines.m001?.target).toEqual(target);
  });

  it("of another session is none of ours", () => {
    expect(event(loaded, proposed("somebody"))).toBe(loaded);
  });

  it("that is refused keeps the old target and says why", () => {
    const aimed = event(loaded, proposed("me"));
    const next = event(aimed, proposed("me", "Grazing ray.", null));
    expect(next.machines.m001?.target).toEqual(target);
    expect(next.targetRefusals.m001).toBe("Grazing ray.");
  });

  it("clears an earlier refusal", () => {
    const refused = event(loaded, proposed("me", "Grazing ray.", null));
    expect(event(refused, proposed("me")).targetRefusals.m001).toBe("");
  });
});

describe("plans", () => {
  it("are not set back by the late answer to the request", () => {
    const ready = event(loaded, { kind: "plan.updated", plan: plan("p1", "ready") });
    const late = reduceLive(ready, { kind: "plan", plan: plan("p1", "previewing") });
    expect(late.plans.p1?.state).toBe("ready");
  });

  it("are forgotten in the end", () => {
    let live = loaded;
    for (let i = 0; i < 200; i++)
      live = event(live, { kind: "plan.updated", plan: plan(`p${i}`, "ready") });
    expect(Object.keys(live.plans).length).toBeLessThanOrEqual(50);
    expect(live.plans.p199).toBeDefined();
  });
});

describe("throws, leases, alerts", () => {
  it("follow the last word", () => {
    const row = (phase: Throw["phase"]) => ({ throw_id: "t1", phase }) as Throw;
    const one = event(loaded, { kind: "throw.updated", throw: row("throwing") });
    const two = event(one, { kind: "throw.updated", throw: row("ended") });
    expect(two.throws.t1?.phase).toBe("ended");
  });

  it("keep the last word of a diagnosis, until all is asked anew", () => {
    const run = (progress_ratio: number) =>
      ({ gap_run_id: "g1", state: "running", progress_ratio }) as GapRun;
    const one = event(loaded, { kind: "gap.updated", run: run(0.2) });
    const two = event(one, { kind: "gap.updated", run: run(0.6) });
    expect(two.gapRuns.g1?.progress_ratio).toBe(0.6);
    const twin = event(two, { kind: "twin.updated", machine_id: "m001", version_count: 3 });
    expect(twin).toBe(two);
    const site = { machine_id: "m001", version_count: 2, objects: [] } as never;
    expect(event(two, { kind: "site.updated", site }).sites.m001?.version_count).toBe(2);
    expect(reduceLive(two, { kind: "resync", machines: [] }).gapRuns).toEqual({});
  });

  it("remember why a lease changed", () => {
    const lease = { ...machine().lease, holder: "sue", epoch_count: 2 };
    const next = event(loaded, {
      kind: "lease.changed",
      lease,
      cause: "taken",
      by: "sue",
      reason: "drill",
    });
    expect(next.machines.m001?.lease.holder).toBe("sue");
    expect(next.leaseNews.m001?.reason).toBe("drill");
  });

  it("show a repeated alert once, and dismiss it", () => {
    const alert = {
      kind: "alert",
      severity: "error",
      code: "x",
      text: "!",
      machine_id: "m001",
    } as const;
    const twice = event(event(loaded, alert), alert);
    expect(twice.alerts).toHaveLength(1);
    const id = twice.alerts[0]?.id ?? 0;
    expect(reduceLive(twice, { kind: "dismiss", id }).alerts).toEqual([]);
  });
});
