/** Words about rollouts. */

import { estimateWords } from "../validation/words";
import type { Rollout, RolloutChange, RolloutMachine } from "./useRollouts";

export const STATE_WORDS: Record<Rollout["state"], string> = {
  running: "Running",
  paused: "Paused",
  completed: "Completed",
  aborted: "Aborted",
  rolled_back: "Rolled back",
};

export const MACHINE_WORDS: Record<RolloutMachine["state"], string> = {
  waiting: "its stage has not begun",
  asked: "asked, has not switched",
  testing: "throws are counted",
  passed: "passed",
  worse: "worse",
  error: "needs a look",
};

export const CHANGE_WORDS: Record<RolloutChange, string> = {
  pause: "Pause",
  resume: "Resume",
  promote: "End the stage now",
  abort: "Abort",
};

/** What follows from a change, before it is done. */
export function consequence(change: RolloutChange, rollout: Rollout): string {
  const isLast = rollout.stage_count + 1 === rollout.stages.length;
  switch (change) {
    case "pause":
      return "No further machine is asked. Those that have switched throw on with it, and worse throws still take them back.";
    case "resume":
      return "Machines that have not switched get the whole time again.";
    case "promote":
      return isLast
        ? "The rollout is completed without waiting for further throws. Machines that have not switched do so later."
        : "The next stage begins without waiting for further throws. Machines that have not switched do so later.";
    default:
      return `Every machine that was asked goes back to the version before as soon as no plan is armed. Plans that were previewed with ${rollout.policy_id} are refused.`;
  }
}

export const changesOf = (rollout: Rollout): RolloutChange[] =>
  rollout.state === "running"
    ? ["pause", "promote", "abort"]
    : rollout.state === "paused"
      ? ["resume", "promote", "abort"]
      : [];

type Figures = NonNullable<RolloutMachine["since"]>;

/** "mean +0.010 (…), sd 0.043 (…)" of one direction. */
export function figureWords(figures: Figures | null, way: "downrange" | "crossrange"): string {
  if (figures === null || figures.throw_count === 0) return "–";
  const mean = figures[`mean_${way}_error_m`];
  const sd = figures[`sd_${way}_m`];
  return `mean ${estimateWords(mean, true)}, sd ${estimateWords(sd, false)}`;
}

/** Stages as a person writes them: a line each, machines and tags separated by commas. */
export function parseStages(text: string): { machine_ids: string[]; tags: string[] }[] {
  return text
    .split("\n")
    .map((line) =>
      line
        .split(",")
        .map((name) => name.trim())
        .filter((name) => name !== ""),
    )
    .filter((names) => names.length > 0)
    .map((names) => ({
      machine_ids: names.filter((name) => !name.startsWith("tag:")),
      tags: names.filter((name) => name.startsWith("tag:")).map((name) => name.slice(4)),
    }));
}
