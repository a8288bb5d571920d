/** A job's state and figures in words. */

import { count, fixed, metres, percent, unbroken } from "../words/format";
import type { Job, JobLoad } from "./job";

/** "2.30 m³". */
export const cubic = (value: number | null | undefined, digits = 2) =>
  value === null || value === undefined ? "–" : `${fixed(value, digits)} m³`;

/** "40 min", "2 h 10 min"; a dash where nobody can tell yet. */
export function leftWords(time_left_s: number | null | undefined): string {
  if (time_left_s === null || time_left_s === undefined) return "–";
  const minutes = Math.max(1, Math.round(time_left_s / 60));
  if (minutes < 90) return `${minutes} min`;
  const rest = Math.round((minutes % 60) / 10) * 10;
  const hours = Math.floor(minutes / 60) + (rest === 60 ? 1 : 0);
  return rest === 0 || rest === 60 ? `${hours} h` : `${hours} h ${rest} min`;
}

/** What one looks at first, in the order of the eye. */
export function figures(job: Job): readonly { name: string; value: string }[] {
  const { progress } = job;
  const thrown = job.loads.filter((load) => !load.is_withdrawn).length;
  return [
    { name: "Filled", value: percent(progress.filled_ratio, 1) },
    { name: "Missing", value: cubic(progress.missing_m3) },
    { name: "Unevenness, 1σ", value: metres(progress.unevenness_m) },
    { name: "Spilled", value: percent(progress.spill_ratio, 1) },
    { name: `Thrown in ${count(thrown, "load")}`, value: cubic(job.thrown_m3) },
    {
      name: "Loads per hour",
      value: job.loads_per_s === null ? "–" : fixed(3600 * job.loads_per_s, 0),
    },
    { name: "Time left, about", value: leftWords(job.time_left_s) },
  ];
}

const LANDED: Record<JobLoad["landed_by"], string> = {
  measured: "measured",
  predicted: "predicted, not measured",
  entered: "entered by hand",
};

export function landedWords(load: Pick<JobLoad, "landed_by" | "spread_m">): string {
  if (load.spread_m === null) return LANDED[load.landed_by];
  const [along, across] = load.spread_m;
  return `${LANDED[load.landed_by]}, spread ${fixed(along, 2)} × ${metres(across)} (1σ)`;
}

/** A proposal's reason as it is set on a page. */
export const reasonWords = (sentence: string) =>
  unbroken(sentence.replace(/(?<=\d) m3\b/g, "\u00a0m³").replace(/(?<= )-(?=\d)/g, "−"));

/** Why there is no proposal, and what to do; null where there are some, or a plan is being made. */
export function noPlanWords(job: Job): string | null {
  if (job.plan_state === "nothing_left")
    return "Nothing is left to throw: every further load would make it worse. End the job, or upload a survey if the ground looks different.";
  if (job.plan_state === "failed") {
    const why = (job.plan_error ?? "The plan failed").replace(/[.\s]*$/, ".");
    return `${why.charAt(0).toUpperCase()}${why.slice(1)} Upload a survey, or end this job and start another.`;
  }
  return null;
}

/** Percent filled and spilled after a load. */
export type CoursePoint = { load: number; filled: number; spilled: number };

/** The course over the loads that count, from the start on. */
export function courseOf(job: Pick<Job, "loads">): CoursePoint[] {
  const points = job.loads
    .filter((load) => !load.is_withdrawn)
    .flatMap(({ load_count, filled_ratio, spill_ratio }) =>
      filled_ratio === null
        ? []
        : [{ load: load_count, filled: 100 * filled_ratio, spilled: 100 * (spill_ratio ?? 0) }],
    );
  return [{ load: 0, filled: 0, spilled: 0 }, ...points];
}
