import { describe, expect, it } from "vitest";
import type { Schema } from "../../session/client";
import { checkSentence, type Gate } from "../gate";
import { isRepeatedCheck, refusalsWithoutRepeats } from "./repeatedMessages";

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
  { reason: "preview_refused", detail: "Refused: predicted miss 0.70 m.", surface_m: null },
  { reason: "out_of_reach", detail: "Refused: target 14.00 m.", surface_m: null },
];

describe("messages that the footer shows already", () => {
  it("an empty gripper is shown once", () => {
    expect(isRepeatedCheck(payload, empty)).toBe(true);
    expect(isRepeatedCheck(pump, empty)).toBe(false);
  });

  it("a refusal in the same words is shown once", () => {
    const gate: Gate = { id: "refused", sentence: refusals[1]?.detail ?? "", action: null };
    expect(refusalsWithoutRepeats(refusals, gate)).toEqual([refusals[0]]);
  });

  it("a failed check is shown once", () => {
    const gate: Gate = { id: "check", sentence: checkSentence(pump), action: null };
    expect(isRepeatedCheck(pump, gate)).toBe(true);
    expect(isRepeatedCheck(payload, gate)).toBe(false);
  });

  it("everything is shown where the footer shows nothing or something else", () => {
    const moving: Gate = { id: "moving", sentence: "m001 is moving.", action: null };
    for (const gate of [null, moving]) {
      expect(refusalsWithoutRepeats(refusals, gate)).toEqual(refusals);
      expect(isRepeatedCheck(payload, gate)).toBe(false);
    }
  });
});
