/** Words about the differences of two versions. */

import { fixed, percent, signed } from "../words/format";
import type { Difference } from "./useComparison";

const QUANTITIES: Record<string, string> = {
  landed: "Landed",
  "mean down": "Mean along",
  "sd down": "Spread along",
  "mean cross": "Mean across",
  "sd cross": "Spread across",
};

export const quantityWords = (quantity: string) => QUANTITIES[quantity] ?? quantity;

/** A share in per cent, a mean with its sign, a spread; lengths in metres. */
export function valueWords(quantity: string, value: number | null): string {
  if (quantity === "landed") return percent(value, 1);
  return quantity.startsWith("mean") ? signed(value, 3) : fixed(value, 3);
}

/** Ends of an interval of a ratio this many times apart, as of five throws beside five, are no comparison. */
const WIDE_RATIO = 10;

/** "-0.02 to +0.01"; a spread as the ratio of the second to the first: "0.8 to 1.3 times". */
export function differenceWords({ quantity, difference, verdict }: Difference): string {
  if (difference === null) return fixed(null);
  const [low, high] = difference;
  if (quantity === "landed") return `${signed(low * 100, 1)} to ${signed(high * 100, 1)} %`;
  const isWide = verdict === "cannot tell" && high > WIDE_RATIO * low;
  if (quantity.startsWith("sd") && isWide) return "any ratio";
  if (quantity.startsWith("sd")) return `${fixed(low)} to ${fixed(high)} times`;
  return `${signed(low, 3)} to ${signed(high, 3)}`;
}

/** "better", "worse", "cannot tell from 20 and 20 throws". */
export const verdictWords = ({ verdict, a_throw_count, b_throw_count }: Difference) =>
  verdict === "cannot tell"
    ? `cannot tell from ${a_throw_count} and ${b_throw_count} throws`
    : verdict;
