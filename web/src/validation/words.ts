/** Words about validations: numbers of gates, the verdict, a number with its interval. */

import { count, fixed, percent, signed } from "../words/format";
import type { GateCheck, Validation } from "./useValidation";

/** "0.043 m", "98.9 %", "0.06 ms", "1.04 times". */
export function gateNumber(value: number | null, unit: GateCheck["unit"]): string {
  switch (unit) {
    case "m":
      return value === null ? fixed(value) : `${fixed(value, 3)} m`;
    case "ratio":
      return percent(value, 1);
    case "s":
      return value === null ? fixed(value) : `${fixed(value * 1e3, 2)} ms`;
    default:
      return value === null ? fixed(value) : `${fixed(value, 2)} times`;
  }
}

/** "at most 0.150 m", "at least 99.0 %". */
export const limitWords = (check: GateCheck) =>
  `${check.is_minimum ? "at least" : "at most"} ${gateNumber(check.limit, check.unit)}`;

type Estimate = { value: number | null; ci95: readonly number[] | null };

/** "0.043 (0.031 to 0.070)"; a mean has a sign. */
export function estimateWords({ value, ci95 }: Estimate, isMean: boolean): string {
  const show = isMean ? signed : fixed;
  const text = show(value, 3);
  return ci95 === null ? text : `${text} (${show(ci95[0], 3)} to ${show(ci95[1], 3)})`;
}

/** "Passed all 9 gates", "2 of 9 gates not passed", or why there is no result. */
export function validationWords(one: Validation): string {
  switch (one.state) {
    case "queued":
      return "Waits for its turn";
    case "running":
      return "Is being validated";
    case "cancelled":
      return "The validation was cancelled";
    case "failed":
      return `The validation failed: ${one.detail}`;
    default: {
      const checks = one.result?.checks ?? [];
      const missed = checks.filter((check) => !check.is_passed).length;
      if (missed === 0) return `Passed all ${count(checks.length, "gate")}`;
      return `${missed} of ${count(checks.length, "gate")} not passed`;
    }
  }
}
