/** What the foot of the panel says already, and the Preview step need not say again. */

import type { Schema } from "../session/client";
import type { Gate } from "./gate";

type Check = Schema["CheckResult"];
type Refusal = Schema["RefusalView"];

/** One fact in three places: a check of the machine, a refusal of the preview, a sentence of the foot. */
const EMPTY = { gate: "no_payload", reason: "no_payload", check_id: "payload" };

export const checkSentence = (check: Check) => `${check.text} ${check.remedy}`.trim();

export function untoldRefusals(
  refusals: readonly Refusal[],
  checks: readonly Check[],
  gate: Gate | null,
): Refusal[] {
  const isEmptyTold =
    gate?.id === EMPTY.gate || checks.some((c) => c.check_id === EMPTY.check_id && !c.passed);
  return refusals.filter(
    ({ detail, reason }) => detail !== gate?.sentence && !(isEmptyTold && reason === EMPTY.reason),
  );
}

export function isToldCheck(check: Check, gate: Gate | null): boolean {
  if (gate?.id === EMPTY.gate) return check.check_id === EMPTY.check_id;
  return gate?.id === "check" && gate.sentence === checkSentence(check);
}
