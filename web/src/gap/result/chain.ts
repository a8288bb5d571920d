/** The chain from command to impact as the page draws it: every stage, with what it adds to the miss. */

import { VOCABULARY } from "../../api/vocabulary";
import { type Diagnosis, stageMark } from "../words";

export type Term = {
  joint: string | null;
  downrange_m: number;
  crossrange_m: number;
  share_ratio: number;
  ci90_m: readonly [number, number];
  isNamed: boolean;
};

export type Link = {
  stage: string;
  title: string;
  between: string;
  terms: readonly Term[];
  downrange_m: number;
  crossrange_m: number;
  /** What the verdict says of this stage when it points here; else empty. */
  here: string;
};

export type Chain = {
  links: readonly Link[];
  /** Half of every interval bar, m. */
  limit_m: number;
  /** False for one stage recorded alone: its share is known, metres are not. */
  isMetric: boolean;
};

export function chainOf(found: Diagnosis): Chain {
  const here =
    found.verdict === "none" ? largestStage(found) : placeOf(found.evidence.where)?.stage;
  const named = placesOf(found.evidence.named);
  const numbers = found.stages.flatMap((term) => [...term.ci90_m, term.miss_m.downrange]);
  const limit_m = Math.max(0, ...numbers.filter(Number.isFinite).map(Math.abs));
  const links = VOCABULARY.stages.map(({ stage, title, link: between }) => {
    const terms = found.stages
      .filter((term) => term.stage === stage)
      .map((term) => ({
        joint: term.joint ?? null,
        downrange_m: term.miss_m.downrange,
        crossrange_m: term.miss_m.crossrange,
        share_ratio: term.share_ratio,
        ci90_m: term.ci90_m,
        isNamed: named.some((place) => place.stage === stage && place.joint === term.joint),
      }));
    return {
      stage,
      title,
      between,
      terms,
      downrange_m: sum(terms.map((term) => term.downrange_m)),
      crossrange_m: sum(terms.map((term) => term.crossrange_m)),
      here:
        stage === here || named.some((place) => place.stage === stage)
          ? stageMark(found.verdict)
          : "",
    };
  });
  return { links, limit_m, isMetric: limit_m > 0 };
}

/** Where nothing is wrong the evidence points to what would come nearest, not to what adds most. */
function largestStage({ stages }: Diagnosis): string | undefined {
  const shareOf = (stage: string) =>
    sum(stages.filter((term) => term.stage === stage).map((term) => term.share_ratio));
  return stages.map((term) => term.stage).toSorted((a, b) => shareOf(b) - shareOf(a))[0];
}

function sum(values: readonly number[]): number {
  return values.reduce((total, value) => total + value, 0);
}

type Place = { stage: string; joint: string | null };

/** Stage and joint, as evidence has them; older diagnoses have no more than `where`. */
function placeOf(value: unknown): Place | null {
  const { stage, joint } = (value ?? {}) as Record<string, unknown>;
  return typeof stage === "string"
    ? { stage, joint: typeof joint === "string" ? joint : null }
    : null;
}

const placesOf = (values: unknown): Place[] =>
  Array.isArray(values) ? values.flatMap((value) => placeOf(value) ?? []) : [];
