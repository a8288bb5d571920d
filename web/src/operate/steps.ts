/** Which of the four steps of the panel is the present one. */

import { isMoving } from "../machine/phase";
import type { Machine, Plan, Throw } from "../session/live";
import type { Hold } from "./hold/hold";
import type { Target } from "./target/target";

export type StepName = "target" | "preview" | "throw" | "result";

export const STEPS: readonly StepName[] = ["target", "preview", "throw", "result"];

export type StepFacts = {
  machine: Machine | null;
  target: Target | null;
  plan: Plan | null;
  hold: Hold;
  /** The last throw of this machine that this console shows; null after "throw again". */
  result: Throw | null;
};

export function presentStep({ machine, target, plan, hold, result }: StepFacts): StepName {
  const isHolding = hold.phase !== "idle";
  if (isHolding || (machine && isMoving(machine.lamp))) return "throw";
  if (result) return "result";
  if (!target) return "target";
  if (!plan || plan.target === null) return "preview";
  return "preview";
}
