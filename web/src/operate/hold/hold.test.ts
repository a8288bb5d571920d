import { describe, expect, it } from "vitest";
import {
  type Action,
  buttonWords,
  type Hold,
  type HoldEvent,
  IDLE,
  isAbortable,
  reduce,
} from "./hold";

/** Feed events; collect all actions in order. */
function play(events: HoldEvent[], from: Hold = IDLE): { state: Hold; actions: Action[] } {
  const actions: Action[] = [];
  let state = from;
  for (const event of events) {
    const [next, wanted] = reduce(state, event);
    state = next;
    actions.push(...wanted);
  }
  return { state, actions };
}

const press: HoldEvent = { kind: "press" };
const ring: HoldEvent = { kind: "ring_full" };
const armed: HoldEvent = { kind: "armed" };
const fired: HoldEvent = { kind: "fired", throwId: "t1" };
const letGo: HoldEvent = { kind: "release", cause: "released" };
const machine = (
  phase: "throwing" | "committed" | "settling" | "disarmed" | "stopped" | "lost",
  throwId: string | null = "t1",
): HoldEvent => ({
  kind: "machine",
  phase,
  throwId,
});
const HELD = [press, ring, armed, fired];

describe("a throw that goes well", () => {
  it("arms after the ring, fires, beats, commits, ends", () => {
    const { state, actions } = play([
      ...HELD,
      machine("throwing"),
      machine("committed"),
      machine("settling"),
    ]);
    expect(actions).toEqual(["start_ring", "arm", "fire", "beat", "rest"]);
    expect(state).toEqual(IDLE);
  });

  it("ignores a second press while one runs (key repeat, second finger)", () => {
    for (const count of [1, 2, 3, 4]) {
      const { actions } = play([...HELD.slice(0, count), press, press]);
      expect(actions.filter((action) => action === "start_ring")).toHaveLength(1);
    }
  });

  it("does not end on the state that was shown before the throw began", () => {
    expect(play([...HELD, machine("disarmed", null)]).state.phase).toBe("holding");
    expect(play([...HELD, machine("settling", "t0")]).state.phase).toBe("holding");
  });
});

describe("letting go", () => {
  it("in the ring sends nothing at all", () => {
    const { state, actions } = play([press, letGo, ring]);
    expect(actions).toEqual(["start_ring", "stop_ring"]);
    expect(state.phase).toBe("idle");
  });

  it("while arming disarms when the answer comes, and never fires", () => {
    const { state, actions } = play([press, ring, letGo, armed]);
    expect(actions).toEqual(["start_ring", "arm", "disarm"]);
    expect(state.phase).toBe("idle");
  });

  it("while firing aborts, and aborts again once the throw has a name", () => {
    const { actions } = play([press, ring, armed, letGo, fired]);
    expect(actions).toEqual(["start_ring", "arm", "fire", "abort", "rest", "abort"]);
  });

  it("before the commit point stops the signal and aborts", () => {
    const { state, actions } = play([...HELD, letGo]);
    expect(actions.slice(-2)).toEqual(["rest", "abort"]);
    expect(state.phase).toBe("letting_go");
  });

  it("after it only stops the signal, and the state says that it goes on", () => {
    const { state, actions } = play([...HELD, machine("committed"), letGo]);
    expect(actions.at(-1)).toBe("rest");
    expect(actions).not.toContain("abort");
    expect(state).toMatchObject({ phase: "committed", isPressed: false });
    expect(buttonWords(state)).toMatch(/no longer stops/);
  });

  it("too late is reported as committed, not as aborted", () => {
    const { state } = play([...HELD, letGo, machine("committed")]);
    expect(state).toMatchObject({ phase: "committed", isPressed: false });
  });

  it.each(["blur", "hidden", "cancelled", "disabled"] as const)("by %s is letting go", (cause) => {
    const { state, actions } = play([...HELD, { kind: "release", cause }]);
    expect(actions.slice(-2)).toEqual(["rest", "abort"]);
    const end = play([machine("settling")], state).state;
    expect(end).toMatchObject({ phase: "idle" });
    expect((end as { note: string }).note).toMatch(/aborted/);
  });

  it("twice is letting go once", () => {
    const { actions } = play([...HELD, letGo, letGo, { kind: "release", cause: "blur" }]);
    expect(actions.filter((action) => action === "abort")).toHaveLength(1);
  });
});

describe("what can fail", () => {
  it("shows a refusal to arm and sends nothing more", () => {
    const { state, actions } = play([press, ring, { kind: "failed", text: "Load first." }]);
    expect(state).toEqual({ phase: "idle", note: "Load first." });
    expect(actions).toEqual(["start_ring", "arm"]);
  });

  it("aborts after a fire whose answer was lost", () => {
    const { actions } = play([press, ring, armed, { kind: "failed", text: "Unknown." }]);
    expect(actions.slice(-2)).toEqual(["rest", "abort"]);
  });

  it("lets go when the hold signal breaks", () => {
    const { state, actions } = play([...HELD, { kind: "link_lost" }]);
    expect(actions.slice(-2)).toEqual(["rest", "abort"]);
    expect(state).toMatchObject({ phase: "idle" });
  });

  it("never fires when the hold signal broke before", () => {
    const early = play([press, { kind: "link_lost" }, ring]);
    expect(early.actions).toEqual(["start_ring", "stop_ring"]);
    const arming = play([press, ring, { kind: "link_lost" }, armed]);
    expect(arming.actions.at(-1)).toBe("disarm");
    expect(arming.state).toMatchObject({ phase: "idle" });
    expect(play([press, ring, armed, { kind: "link_lost" }]).actions.slice(-1)).toEqual(["abort"]);
  });

  it("ends at once on STOP, in every phase after arming", () => {
    for (const events of [HELD, [...HELD, letGo], [...HELD, machine("committed")]]) {
      const { state, actions } = play([...events, machine("stopped")]);
      expect(state).toEqual({ phase: "idle", note: "STOP is latched." });
      expect(actions.at(-1)).toBe("rest");
    }
  });

  it("ends when the throw is reported as ended, and only ours", () => {
    expect(play([...HELD, { kind: "ended", throwId: "t0" }]).state.phase).toBe("holding");
    expect(play([...HELD, { kind: "ended", throwId: "t1" }]).state.phase).toBe("idle");
  });
});

/** Every sequence of up to six events: the button never fires unless it is held. */
describe("every short history", () => {
  const all: HoldEvent[] = [
    press,
    letGo,
    ring,
    armed,
    fired,
    machine("committed"),
    machine("settling"),
  ];

  it("never fires or beats after letting go, until pressed again", () => {
    const walk = (state: Hold, isHeld: boolean, depth: number): void => {
      if (depth === 0) return;
      for (const event of all) {
        const [next, actions] = reduce(state, event);
        const held = event.kind === "press" || (isHeld && event.kind !== "release");
        if (actions.includes("fire") || actions.includes("beat")) expect(held).toBe(true);
        if (isAbortable(next) && next !== state) expect(held).toBe(true);
        walk(next, held, depth - 1);
      }
    };
    walk(IDLE, false, 6);
  });
});
