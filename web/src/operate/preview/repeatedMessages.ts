/** Messages that the footer of the panel shows already, so that the Preview step leaves them out. */

import type { Schema } from "../../session/client";
import { checkSentence, type Gate } from "../gate";

type Check = Schema["CheckResult"];
type Refusal = Schema["RefusalView"];

/** An empty gripper appears as a check of the machine and as a gate. */
const EMPTY = { gate: "no_payload", check_id: "payload" };

export function refusalsWithoutRepeats(refusals: readonly Refusal[], gate: Gate | null): Refusal[] {
  return refusals.filter(({ detail }) => detail !== gate?.sentence);
}

export function isRepeatedCheck(check: Check, gate: Gate | null): boolean {
  if (gate?.id === EMPTY.gate) return check.check_id === EMPTY.check_id;
  return gate?.id === "check" && gate.sentence === checkSentence(check);
}
