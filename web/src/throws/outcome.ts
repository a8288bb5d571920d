/** How a throw ended, in words. */

import type { Throw } from "../session/live";

export type Outcome = NonNullable<Throw["outcome"]>;

const WORDS: Record<Outcome, string> = {
  landed: "Landed",
  aborted: "Aborted",
  stopped: "Stopped",
  fault: "Fault",
  interrupted: "Interrupted",
  refused: "Refused",
  not_executed: "Not executed",
};

export const OUTCOMES = Object.keys(WORDS) as Outcome[];

export const outcomeWord = (outcome: Outcome) => WORDS[outcome];

/** What stands in the history: the outcome, or the phase while it runs. */
export function statusWord(thrown: Throw): string {
  if (thrown.outcome) return WORDS[thrown.outcome];
  return thrown.phase === "unknown"
    ? "Unknown"
    : `${thrown.phase[0]?.toUpperCase()}${thrown.phase.slice(1)}`;
}

/** Outcome with the machine's own words. */
export function outcomeSentence(thrown: Throw): string {
  const word = statusWord(thrown);
  return thrown.detail ? `${word}: ${thrown.detail}` : `${word}.`;
}

/** Whether a load came down somewhere: it landed, or it had left when the throw was ended. */
export const hasLanded = (thrown: Throw): boolean =>
  thrown.outcome === "landed" || thrown.release_speed_m_per_s !== null;
