/** Evaluations on a policy card, read with care: cards of other versions may say more or less. */

export type EvaluationRow = {
  range_m: number;
  height_m: number;
  throw_count: number | null;
  success_ratio: number | null;
  mean_downrange_error_m: number | null;
  sd_downrange_m: number | null;
  mean_crossrange_error_m: number | null;
  sd_crossrange_m: number | null;
};

export type Evaluation = { id: string; where: string; rows: EvaluationRow[] };

type Loose = Record<string, unknown>;

function number(row: Loose, ...names: string[]): number | null {
  for (const name of names) {
    const value = row[name];
    if (typeof value === "number" && Number.isFinite(value)) return value;
  }
  return null;
}

function landedShare(row: Loose): number | null {
  const landed = number(row, "landed_count", "landed");
  const thrown = number(row, "throws", "throw_count");
  return landed !== null && thrown !== null && thrown > 0 ? landed / thrown : null;
}

function isRecord(value: unknown): value is Loose {
  return typeof value === "object" && value !== null && !Array.isArray(value);
}

function readRow(row: Loose): EvaluationRow | null {
  const range_m = number(row, "range_m");
  if (range_m === null) return null;
  return {
    range_m,
    height_m: number(row, "height_m") ?? 0,
    throw_count: number(row, "throws", "throw_count"),
    success_ratio: number(row, "success_ratio") ?? landedShare(row),
    mean_downrange_error_m: number(row, "mean_downrange_error_m", "downrange_mean_m"),
    sd_downrange_m: number(row, "sd_downrange_m", "downrange_sd_m"),
    mean_crossrange_error_m: number(row, "mean_crossrange_error_m", "crossrange_mean_m"),
    sd_crossrange_m: number(row, "sd_crossrange_m", "crossrange_sd_m"),
  };
}

const PLANTS: Record<string, string> = {
  training: "training simulator",
  twin: "twin",
  virtual: "virtual machine",
};

/** Which simulator, which of its machines, and whether that one aimed by its registration. */
function whereOf(evaluation: Loose): string {
  const plant = typeof evaluation.plant === "string" ? evaluation.plant : "unnamed plant";
  const words = [PLANTS[plant] ?? plant];
  const unit = number(evaluation, "unit_seed");
  if (unit !== null && plant !== "twin") words.push(`unit ${unit}`);
  if (evaluation.is_registered === true) words.push("registered");
  return words.join(", ");
}

export function readEvaluations(evaluations: readonly unknown[]): Evaluation[] {
  return evaluations.filter(isRecord).flatMap((evaluation, index) => {
    const list = evaluation.targets ?? evaluation.throws;
    if (!Array.isArray(list)) return [];
    const rows = list.filter(isRecord).flatMap((row) => readRow(row) ?? []);
    return rows.length > 0 ? [{ id: `${index}`, where: whereOf(evaluation), rows }] : [];
  });
}
