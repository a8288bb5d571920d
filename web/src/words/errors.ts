/** What a refusal means and what to do next. The server's own sentence comes first where it gives one. */

import { ApiError } from "../session/client";

/** One next step for a code; only where the server cannot know the console's own controls. */
const NEXT_STEP: Record<string, string> = {
  offline: "Check the network; the console keeps trying.",
  no_lease: "Take control first.",
  lease_held: "Wait for the holder, or let a supervisor take over.",
  stop_latched: "Clear STOP, then arm again.",
  no_payload: "Load first.",
  not_disarmed: "Wait until the machine has settled.",
  nonce_expired: "Hold again.",
  nonce_unknown: "Hold again.",
  plan_mismatch: "Preview again, then hold.",
  aim_mismatch: "Preview again, then hold.",
  plan_expired: "Preview again, then hold.",
  plan_used: "Preview again, then hold.",
  machine_moved: "Preview again, then hold.",
  site_changed: "Preview again, then hold.",
  preview_failed: "Preview again.",
  policy_mismatch: "Preview again with the policy on board.",
  model_mismatch: "Update the machine or the server: their machine models differ.",
  machine_lost: "The machine holds by itself; wait for the link.",
  unknown_outcome: "Wait: the machine reports what it did. Nothing is sent twice.",
};

export function errorWords(error: unknown): string {
  if (!(error instanceof ApiError)) return "Something failed inside the console. Reload the page.";
  const next = NEXT_STEP[error.code];
  const sentence = error.message.trim();
  if (!next || sentence.includes(next)) return sentence;
  return `${sentence.replace(/[.\s]*$/, ".")} ${next}`;
}

export const errorCode = (error: unknown) => (error instanceof ApiError ? error.code : "internal");
