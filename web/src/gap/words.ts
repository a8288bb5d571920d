/** A diagnosis in the words of the report: the server sends them; what is left here depends on the page. */

import { VOCABULARY } from "../api/vocabulary";
import type { Schema } from "../session/client";
import { fixed, percent } from "../words/format";

export type Diagnosis = Schema["Diagnosis"];
export type Run = Schema["GapRunRow"];
export type Verdict = Schema["VerdictKind"];
export type DiagnosisWords = Schema["DiagnosisWords"];

const { verdicts: VERDICTS } = VOCABULARY;

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

export const shareWords = (ratio: number) =>
  fill(SENTENCES.share_of_terms, { share: percent(ratio) });

export const intervalWords = (low: string, high: string) =>
  fill(SENTENCES.interval_90, { low, high });

/** How long it may take: what earlier ones took, never a guess. */
export function usualWords({ usual_s }: Run): string {
  if (!usual_s) return "No earlier one tells how long it takes.";
  const [low, high] = usual_s.map((value) => Math.max(1, Math.round(value)));
  return low === high
    ? `The last one like it took ${low} s.`
    : `The last ones like it took ${low} to ${high} s.`;
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
export function additionWords({ causes }: DiagnosisWords): string {
  const parts = (causes[0]?.effects ?? []).map(({ title, sizes }) => {
    return `${title}: ${sizes.map((size) => `${size.name} ${size.value}`).join(", ")}`;
  });
  return parts.length === 0 ? "Adds nothing." : `Adds ${parts.join("; ")}.`;
}
