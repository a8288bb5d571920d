import { describe, expect, it } from "vitest";
import type { Machine, Plan } from "../session/live";
import { type GateFacts, operateGate } from "./gate";

function facts(isHeld: boolean, lamp: string, plan: object | null): GateFacts {
  const machine = {
    machine_id: "m001",
    lamp,
    lease: {},
    reach: { modes: [{ mode: "2d", policy_sha256: "p" }] },
    state: { payload_held: isHeld, policy_sha256: { "2d": "p" }, checks: [] },
  } as unknown as Machine;
  return {
    stale_s: null,
    isLoaded: true,
    machine,
    isHolder: true,
    permissions: ["throw"],
    username: "anna",
    mode: "2d",
    target: { range_m: 9 } as GateFacts["target"],
    plan: plan as Plan | null,
    planError: null,
  };
}

const inside = {
  state: "refused",
  refusals: [{ detail: "Refused: the target lies inside the bed.", surface_m: 1.2 }],
};
const ready = { state: "ready", is_complete: true, prediction: {}, refusals: [] };

describe("what stands between the operator and a throw", () => {
  it("offers to load an empty gripper while the throw is previewed", () => {
    for (const plan of [null, { ...ready, state: "previewing", is_complete: false }, ready])
      expect(operateGate(facts(false, "disarmed", plan))).toMatchObject({
        id: "no_payload",
        action: "load",
      });
  });
  it("names a target that cannot be hit before the load, with the height that can", () => {
    expect(operateGate(facts(false, "disarmed", inside))).toMatchObject({
      id: "refused",
      action: "use_surface",
      surface_m: 1.2,
    });
  });
  it("says what is being computed", () => {
    const first = { ...ready, state: "previewing", is_complete: false };
    expect(operateGate(facts(true, "disarmed", null))?.sentence).toMatch(/the throw/);
    expect(operateGate(facts(true, "disarmed", first))?.sentence).toMatch(/the spread/);
  });
  it("names the version on board and the server's where they differ, and what to do", () => {
    const one = facts(true, "disarmed", null);
    const machine = one.machine as unknown as {
      reach: object;
      state: { policy_sha256: Record<string, string> };
    };
    machine.reach = {
      modes: [{ mode: "2d", policy_id: "m545-2d-v7", policy_sha256: "a".repeat(64) }],
    };
    machine.state.policy_sha256 = { "2d": "b".repeat(64) };
    expect(operateGate(one)).toEqual({
      id: "wrong_policy",
      sentence:
        "m001 has 2D policy bbbbbbbbbbbb on board, which the server lacks; the server previews with m545-2d-v7 (aaaaaaaaaaaa). Upload the first or deploy the second.",
      action: "open_policies",
    });
    machine.state.policy_sha256 = {};
    expect(operateGate(one)?.sentence).toBe(
      "m001 has no 2D policy on board. Deploy m545-2d-v7 (aaaaaaaaaaaa).",
    );
  });
  it("does not offer to load a machine that moves", () => {
    expect(operateGate(facts(false, "settling", inside))?.id).toBe("moving");
  });
  it("says why a loaded machine's throw is refused", () => {
    const far = { state: "refused", refusals: [{ detail: "Refused: target 14.00 m." }] };
    expect(operateGate(facts(true, "disarmed", far))).toMatchObject({
      id: "refused",
      sentence: "Refused: target 14.00 m.",
    });
  });
  it("lets throw when nothing is in the way", () => {
    expect(operateGate(facts(true, "disarmed", ready))).toBeNull();
  });
});
