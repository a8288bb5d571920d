/** The likely reason of a miss in one line, from what the console itself can see. */

import { sigmaDistance } from "../charts/ellipse";
import type { Plan, Throw } from "../session/live";
import { fixed } from "../words/format";

/** A load that leaves faster by this much explains a long throw better than chance. */
const SPEED_DIFFERENCE_M_PER_S = 0.1;

export type Verdict = { isInside: boolean; text: string };

export function landingVerdict(thrown: Throw, plan: Plan | null): Verdict | null {
  const { measured_downrange_error_m: along, measured_crossrange_error_m: across } = thrown;
  const prediction = plan?.prediction;
  if (along === null || across === null || !prediction?.ellipse) return null;
  if (plan?.material) return { isInside: true, text: "The ellipse is that of a ball." };
  const sigma = sigmaDistance(prediction.ellipse, along, across);
  if (sigma === null) return null;
  if (sigma <= 2)
    return { isInside: true, text: `Inside the 2σ ellipse, ${fixed(sigma, 1)}σ out.` };
  const faster = (thrown.release_speed_m_per_s ?? Number.NaN) - prediction.release_speed_m_per_s;
  const isLong = along > prediction.downrange_error_m;
  const outside = `Outside the 2σ ellipse, ${fixed(sigma, 1)}σ out.`;
  if (Math.abs(faster) >= SPEED_DIFFERENCE_M_PER_S && faster > 0 === isLong) {
    const how = faster > 0 ? "faster" : "slower";
    const text = `${outside} It left ${fixed(Math.abs(faster))} m/s ${how} than previewed.`;
    return { isInside: false, text };
  }
  return { isInside: false, text: `${outside} The release speed does not explain it.` };
}
