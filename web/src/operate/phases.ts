/** The phases of a throw as the timeline shows them, and which one is now. */

import type { Machine, Plan } from "../session/live";

export const PHASES = ["align", "swing", "release", "flight", "settle"] as const;
export type PhaseName = (typeof PHASES)[number];

/** Index of the present phase; -1 before, PHASES.length after. */
export function phaseIndex(machine: Machine | null, isOver: boolean): number {
  if (isOver) return PHASES.length;
  switch (machine?.lamp) {
    case "aligning":
      return 0;
    case "throwing":
      return 1;
    case "committed":
      return machine.state?.payload_held ? 2 : 3;
    case "settling":
      return 4;
    default:
      return -1;
  }
}

const ALIGN_GUESS_S = 4;
const SETTLE_GUESS_S = 5;
const SHORTEST_S = 0.7;

/** Widths of the phases from the prediction, never so thin that the word does not fit. */
export function phaseWidths(plan: Plan | null): number[] {
  const prediction = plan?.prediction;
  const swing = prediction?.release_s ?? 3;
  const flight = prediction?.flight_s ?? 1;
  const align = plan?.mode === "3d" ? SHORTEST_S : ALIGN_GUESS_S;
  return [align, swing, 0.26, flight, SETTLE_GUESS_S].map((width) =>
    Math.min(2.2, Math.max(SHORTEST_S, Math.sqrt(width))),
  );
}
