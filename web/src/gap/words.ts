/** A diagnosis in words: verdicts, stages, causes, sizes; pure, and shared by all of the page. */

import type { Schema } from "../session/client";
import { count, fixed, percent } from "../words/format";

export type Diagnosis = Schema["Diagnosis"];
export type Run = Schema["GapRunRow"];
export type Verdict = Schema["VerdictKind"];
type Fitted = Schema["FittedEffect"];
type Size = Schema["FittedParameter"];

const VERDICTS: Record<Verdict, string> = {
  none: "No gap beyond a healthy machine's",
  explained: "Explained",
  ambiguous: "Ambiguous: two causes fit",
  unknown: "Unknown effect",
  bad_data: "Data cannot be used",
};

const SHORT: Record<Verdict, string> = {
  none: "No gap",
  explained: "Explained",
  ambiguous: "Ambiguous",
  unknown: "Unknown effect",
  bad_data: "Bad data",
};

/** What the stage that the verdict points to is. */
const HERE: Record<Verdict, string> = {
  none: "largest",
  explained: "cause",
  ambiguous: "cause",
  unknown: "unexplained",
  bad_data: "",
};

const STATES: Record<Run["state"], string> = {
  queued: "Waiting",
  running: "Running",
  done: "Done",
  failed: "Failed",
  cancelled: "Cancelled",
  interrupted: "Interrupted",
};

export const hereWord = (verdict: Verdict) => HERE[verdict];

/** Amber is "look": the person has to do something before this means anything. */
export const isLook = (verdict: Verdict | null) =>
  verdict === "ambiguous" || verdict === "unknown" || verdict === "bad_data";

export const isOpen = (run: Run) => run.state === "queued" || run.state === "running";

/** A row as it was asked for, or newer as events told it; an ended run is what was asked for. */
export const newest = (row: Run, told: Readonly<Record<string, Run>>): Run =>
  isOpen(row) ? (told[row.gap_run_id] ?? row) : row;

/** One word for a run: its verdict once there is one, else where it stands. */
export const runWord = (run: Run) => (run.verdict ? SHORT[run.verdict] : STATES[run.state]);

/** The same as a heading. */
export const runTitle = (run: Run) => (run.verdict ? VERDICTS[run.verdict] : STATES[run.state]);

/** What a run was compared with. */
export const comparedWords = (run: Run) =>
  run.reference_throw_count > 0
    ? `${count(run.reference_throw_count, "healthy throw")} of this machine`
    : "healthy machines of the type";

/** "valve dead time, boom"; of a drift what drifts: "drift of valve lag, boom". */
export function effectWords(effect: string, joint: string | null | undefined): string {
  const [kind = "", drifting] = effect.split(":");
  const name = drifting ? `drift of ${parameterWords(drifting)}` : kind.replaceAll("_", " ");
  return joint ? `${name}, ${joint}` : name;
}

export function fittedWords({ effect, joint, parameters }: Fitted): string {
  const drifting = Object.keys(parameters).find((name) => name.includes("."));
  return effectWords(drifting ? `drift:${drifting.split(".")[0]}` : effect, joint);
}

export function causeWords(cause: Schema["Cause"]): string {
  if (cause.effects.length > 0) {
    return cause.effects.map(fittedWords).join(" + ");
  }
  if (cause.name === "none") return "no effect";
  return cause.name === "unknown" ? "something unknown" : cause.name;
}

/** Never quite certain: a posterior of 1 is a rounding. */
export function probabilityWords(probability: number): string {
  if (probability > 0.995) return "> 99 %";
  return probability < 0.005 ? "< 1 %" : percent(probability);
}

const UNIT_SUFFIX =
  /_(rad_m_per_s|rad_per_s2|rad_per_s|m_per_s|per_s2|per_s|per_m|rad_m|ratio|rad|kg|s|m)$/;

export const parameterWords = (name: string) =>
  name.replaceAll(".", ", ").replace(UNIT_SUFFIX, "").replaceAll("_", " ");

/** Value and interval in the unit a person would choose: "62.0 ms", "55.0 to 70.0 ms". */
export function sizeWords(size: Size): { value: string; interval: string } {
  const largest = Math.max(Math.abs(size.value), ...size.ci90.map(Math.abs));
  const [scale, unit] = shownUnit(size.unit, largest);
  const shown = largest * scale;
  const digits = shown >= 100 ? 0 : shown >= 10 ? 1 : 2;
  const text = (value: number) => fixed(value * scale, digits);
  const tail = unit ? ` ${unit}` : "";
  return {
    value: `${text(size.value)}${tail}`,
    interval: `${text(size.ci90[0])} to ${text(size.ci90[1])}${tail}`,
  };
}

function shownUnit(unit: string, largest: number): [number, string] {
  if (unit === "s" && largest < 1) return [1000, "ms"];
  if (unit === "rad" && largest < 1) return [1000, "mrad"];
  if (unit === "m" && largest < 0.1) return [1000, "mm"];
  if (unit === "m/s" && largest < 0.1) return [1000, "mm/s"];
  return unit === "" || unit === "1" || unit === "ratio" ? [100, "%"] : [1, unit];
}

/** Lines of an effect: what, how large, how sure. */
export function sizesOf(effect: Fitted): { name: string; value: string; interval: string }[] {
  return Object.entries(effect.parameters).map(([name, size]) => ({
    name: parameterWords(name),
    ...sizeWords(size),
  }));
}

/** Of the gap before and after: smaller than the miss that is stated first. */
const HEALTHY_OUT = "Both without what every healthy machine of the type is off its twin by.";

/**
 * How far the gap shrinks. Where the impact is no measure of the effect (a sensor moves none), the recorded
 * channels are, and metres say nothing about the share.
 */
export function shrinkWords(shrink: Schema["Shrink"], measure: unknown): string {
  const isByChannels = measure === "channels";
  const what = isByChannels ? "gap in the channels that it moves" : "removable gap";
  const interval = `90 % interval ${percent(shrink.ci90[0])} to ${percent(shrink.ci90[1])}`;
  const thrown = `on ${shrink.held_out_throws} held-out throws`;
  const parts = [
    shrink.ratio < 0
      ? `Widens the ${what} by ${percent(-shrink.ratio)} ${thrown} (removes ${percent(shrink.ratio)}, ${interval}).`
      : `Removes ${percent(shrink.ratio)} of the ${what} ${thrown}, ${interval}.`,
  ];
  if (typeof shrink.predicted_ratio === "number")
    parts.push(`Predicted before it was added: ${percent(shrink.predicted_ratio)}.`);
  parts.push(
    isByChannels
      ? "The miss itself is no measure here: below, for comparison."
      : `${percent(shrink.removable_ratio)} of the gap is removable, the rest is noise and jitter.`,
  );
  parts.push(HEALTHY_OUT);
  return parts.join(" ");
}

/** Why not to apply what was found; null when held-out throws speak for it. */
export function doubtWords(found: Diagnosis): string | null {
  const { shrink } = found;
  if (!shrink || shrink.ci90[0] > 0) return null;
  return shrink.ratio < 0
    ? `On held-out throws the twin is worse with it: ${fixed(shrink.before_m, 2)} before, ${fixed(shrink.after_m, 2)} after. Do not apply it; throw more and diagnose again.`
    : `Held-out throws do not show that it helps: 90 % interval ${percent(shrink.ci90[0])} to ${percent(shrink.ci90[1])}. Throw more before applying it.`;
}

/** "Adds valve dead time, dipper: extra dead time 62.0 ms." */
export function additionWords(found: Diagnosis): string {
  const effects = found.causes[0]?.effects ?? [];
  const parts = effects.map((effect) => {
    const sizes = sizesOf(effect).map((size) => `${size.name} ${size.value}`);
    return `${fittedWords(effect)}: ${sizes.join(", ")}`;
  });
  return parts.length === 0 ? "Adds nothing." : `Adds ${parts.join("; ")}.`;
}
