/** Rows of a page of the history that hold every word of a text. */

import type { Throw } from "../session/live";
import { bearingShort, fixed } from "../words/format";
import { localStamp } from "../words/time";
import { statusWord } from "./outcome";

const textOf = (row: Throw) =>
  [
    row.throw_id,
    localStamp(row.created_utc),
    row.machine_id,
    row.mode,
    fixed(row.target.range_m),
    bearingShort(row.target.azimuth_rad),
    statusWord(row),
    row.policy_id,
    row.operator,
  ]
    .join(" ")
    .toLowerCase();

export function found(rows: readonly Throw[], text: string): readonly Throw[] {
  const words = text.toLowerCase().split(/\s+/).filter(Boolean);
  if (words.length === 0) return rows;
  return rows.filter((row) => {
    const own = textOf(row);
    return words.every((word) => own.includes(word));
  });
}
