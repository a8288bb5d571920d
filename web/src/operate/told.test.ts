import { describe, expect, it } from "vitest";
import type { Schema } from "../session/client";
import type { Gate } from "./gate";
import { checkSentence, isToldCheck, untoldRefusals } from "./told";

const check = (check_id: string, text: string): Schema["CheckResult"] => ({
  check_id,
  passed: false,
  severity: "error",
  text,
  remedy: "Do this.",
});
const payload = check("payload", "The gripper is empty.");
const pump = check("pressure", "12.0 MPa.");
const empty: Gate = { id: "no_payload", sentence: "The gripper is empty.", action: "load" };
const refusals = [
  { reason: "no_payload", detail: "Refused: the gripper is empty. Take up a load first." },
  { reason: "out_of_reach", detail: "Refused: target 14.00 m." },
];

describe("what the foot of the panel says already", () => {
  it("that the gripper is empty is said once", () => {
    expect(untoldRefusals(refusals, [], empty)).toEqual([refusals[1]]);
    expect(untoldRefusals(refusals, [payload], null)).toEqual([refusals[1]]);
    expect(isToldCheck(payload, empty)).toBe(true);
    expect(isToldCheck(pump, empty)).toBe(false);
  });

  it("a refusal in the same words is said once", () => {
    const gate: Gate = { id: "refused", sentence: refusals[1]?.detail ?? "", action: null };
    expect(untoldRefusals(refusals, [], gate)).toEqual([refusals[0]]);
  });

  it("a failed check is said once", () => {
    const gate: Gate = { id: "check", sentence: checkSentence(pump), action: null };
    expect(isToldCheck(pump, gate)).toBe(true);
    expect(isToldCheck(payload, gate)).toBe(false);
  });

  it("everything is said where the foot says nothing or something else", () => {
    const moving: Gate = { id: "moving", sentence: "m001 is moving.", action: null };
    for (const gate of [null, moving]) {
      expect(untoldRefusals(refusals, [], gate)).toEqual(refusals);
      expect(isToldCheck(payload, gate)).toBe(false);
    }
  });
});
