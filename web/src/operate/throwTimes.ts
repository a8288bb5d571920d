/** Times of a running throw, from its prediction. */

import type { MachinePhase } from "../machine/phase";
import type { Plan } from "../session/live";

/**
 * Seconds to the predicted release, which is the commit point; 0 where it is late, null once the machine
 * has passed it. A prediction only: the machine says when it is committed.
 */
export function toCommit_s(
  phase: MachinePhase,
  plan: Plan | null,
  elapsed_s: number,
): number | null {
  if (phase !== "aligning" && phase !== "throwing") return null;
  const release_s = plan?.prediction?.release_s;
  return release_s === undefined ? Number.NaN : Math.max(0, release_s - elapsed_s);
}
