/** A diagnosis in the words of the report: verdicts, stages, causes, sizes. Pure functions. */

import { VOCABULARY } from "../api/vocabulary";
import type { Schema } from "../session/client";
import { count, fixed, percent } from "../words/format";

export type Diagnosis = Schema["Diagnosis"];
export type Run = Schema["GapRunRow"];
export type Verdict = Schema["VerdictKind"];
type Fitted = Schema["FittedEffect"];
type Size = Schema["FittedParameter"];

const { verdicts: VERDICTS, shown_units, ratio_units, unit_suffixes } = VOCABULARY;

/** Sentences and terms that the report uses, too; names in braces are filled in. */
export const SENTENCES = VOCABULARY.sentences;

/** A sentence with its values filled in. */
function fill(sentence: string, values: Record<string, string | number>): string {
  return sentence.replace(/\{(\w+)\}/g, (_, name: string) => String(values[name] ?? ""));
}

const STATES: Record<Run["state"], string> = {
  queued: "Waiting",
  running: "Running",
  done: "Done",
  failed: "Failed",
  cancelled: "Cancelled",
  interrupted: "Interrupted",
};

/** What the marked stage is: the cause, unexplained, or only the largest. */
export const stageMark = (verdict: Verdict) => VERDICTS[verdict].stage_mark;

/** Shown in amber: the person has to act before the result can be used. */
export const isLook = (verdict: Verdict | null) =>
  verdict !== null && VERDICTS[verdict].needs_attention;

export const isOpen = (run: Run) => run.state === "queued" || run.state === "running";

/** An open run as the latest event has it; an ended run as it was fetched. */
export const newest = (row: Run, events: Readonly<Record<string, Run>>): Run =>
  isOpen(row) ? (events[row.gap_run_id] ?? row) : row;

/** One word for a run: its verdict once there is one, else its state. */
export const runWord = (run: Run) =>
  run.verdict ? VERDICTS[run.verdict].short : STATES[run.state];

/** The same as a heading. */
export const runTitle = (run: Run) =>
  run.verdict ? VERDICTS[run.verdict].title : STATES[run.state];

/** What a run was compared with. */
export const comparedWords = (run: Run) =>
  run.reference_throw_count > 0
    ? fill(SENTENCES.compared_with_machine, {
        count: count(run.reference_throw_count, SENTENCES.healthy_throw),
      })
    : SENTENCES.compared_with_type;

/** "valve dead time, boom"; a drift by what drifts: "drift of valve lag, boom". */
export function effectWords(effect: string, joint: string | null | undefined): string {
  const [kind = "", drifting] = effect.split(":");
  const name = drifting
    ? fill(SENTENCES.drift, { parameter: parameterWords(drifting) })
    : kind.replaceAll("_", " ");
  return joint ? fill(SENTENCES.effect_of_joint, { effect: name, joint }) : name;
}

export function fittedWords({ effect, joint, parameters }: Fitted): string {
  const drifting = Object.keys(parameters).find((name) => name.includes("."));
  return effectWords(drifting ? `drift:${drifting.split(".")[0]}` : effect, joint);
}

export function causeWords(cause: Schema["Cause"]): string {
  if (cause.effects.length > 0) {
    return cause.effects.map(fittedWords).join(" + ");
  }
  const { name } = cause;
  return name === "none" || name === "unknown" ? SENTENCES[name] : name;
}

/** Never 0 % or 100 %: these are roundings. */
export function probabilityWords(probability: number): string {
  if (probability > 0.995) return "> 99 %";
  return probability < 0.005 ? "< 1 %" : percent(probability);
}

/** A parameter without its unit. */
export function parameterWords(name: string): string {
  const suffix = unit_suffixes.find((unit) => name.endsWith(unit)) ?? "";
  return name
    .slice(0, name.length - suffix.length)
    .replaceAll(".", ", ")
    .replaceAll("_", " ");
}

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
    interval:
      fill(SENTENCES.interval, { low: text(size.ci90[0]), high: text(size.ci90[1]) }) + tail,
  };
}

function shownUnit(unit: string, largest: number): [number, string] {
  const small = Object.entries(shown_units).find(([name]) => name === unit)?.[1];
  if (small && largest < small.below) return [small.scale, small.unit];
  return ratio_units.some((ratio) => ratio === unit) ? [100, "%"] : [1, unit];
}

/** Parameters of an effect with value and interval. */
export function sizesOf(effect: Fitted): { name: string; value: string; interval: string }[] {
  return Object.entries(effect.parameters).map(([name, size]) => ({
    name: parameterWords(name),
    ...sizeWords(size),
  }));
}

/** Why an effect was ruled out. */
export function ruledOutWords(why: unknown, logOdds: unknown): string {
  const parts = [
    typeof logOdds === "number" ? fill(SENTENCES.log_odds, { odds: fixed(logOdds, 1) }) : "",
    typeof why === "string" ? why : "",
  ];
  return parts.filter(Boolean).join("; ");
}

export const undecidedWords = ({ members, why }: Schema["Ambiguity"]) =>
  fill(SENTENCES.undecided, { members: members.join(" or "), why });

export const shareWords = (ratio: number) =>
  fill(SENTENCES.share_of_terms, { share: percent(ratio) });

export const intervalWords = (low: string, high: string) =>
  fill(SENTENCES.interval_90, { low, high });

/**
 * How far the gap shrinks on held-out throws. An effect that does not move the impact, such as one of a
 * sensor, is measured on the recorded channels.
 */
export function shrinkWords(shrink: Schema["Shrink"], measure: unknown): string {
  const isByChannels = measure === "channels";
  const parts = [
    fill(shrink.ratio < 0 ? SENTENCES.widens : SENTENCES.removes, {
      share: percent(shrink.ratio),
      growth: percent(-shrink.ratio),
      gap: isByChannels ? SENTENCES.channel_gap : SENTENCES.removable_gap,
      count: shrink.held_out_throws,
      samples: "throws",
      interval: intervalWords(percent(shrink.ci90[0]), percent(shrink.ci90[1])),
    }),
  ];
  if (typeof shrink.predicted_ratio === "number")
    parts.push(fill(SENTENCES.predicted, { share: percent(shrink.predicted_ratio) }));
  parts.push(
    isByChannels
      ? SENTENCES.miss_is_no_measure
      : fill(SENTENCES.removable, { share: percent(shrink.removable_ratio) }),
  );
  parts.push(SENTENCES.without_type_error);
  return parts.join(" ");
}

/** Why not to apply what was found; null when held-out throws confirm it. */
export function doubtWords(found: Diagnosis): string | null {
  const { shrink } = found;
  if (!shrink || shrink.ci90[0] > 0) return null;
  return shrink.ratio < 0
    ? `On held-out throws the twin is worse with it: ${fixed(shrink.before_m, 2)} before, ${fixed(shrink.after_m, 2)} after. Do not apply it; throw more and diagnose again.`
    : `Held-out throws do not show that it helps: ${intervalWords(percent(shrink.ci90[0]), percent(shrink.ci90[1]))}. Throw more before applying it.`;
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
