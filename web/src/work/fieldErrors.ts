/** Beside which field of the dialog the server's sentence belongs. */

import { ApiError } from "../session/client";

const FIELDS = [
  "name",
  "material",
  "grab_m3",
  "wall_m",
  "height_m",
  "length_m",
  "width_m",
  "survey",
];

type Problems = { problems?: readonly { field: string }[] } | null;

/** Null: it belongs to no field. What the goal cannot be done with is said of its place and heights. */
export function fieldOf(error: unknown): string | null {
  if (!(error instanceof ApiError) || error.status !== 422) return null;
  const problems = (error.detail as Problems)?.problems ?? [];
  const parts = problems.flatMap(({ field }) => field.split("."));
  return FIELDS.find((name) => parts.includes(name)) ?? "goal";
}
