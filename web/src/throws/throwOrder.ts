/** Order of one page of the history: as the server sent it, newest first, or by a column. */

import type { Throw } from "../session/live";
import { statusWord } from "./outcome";

type Value = string | number | null;

export const COLUMNS = [
  { key: "time", label: "Time", of: (row: Throw): Value => row.created_utc },
  { key: "machine", label: "Machine", of: (row: Throw): Value => row.machine_id },
  { key: "target", label: "Target, m", of: (row: Throw): Value => row.target.range_m },
  { key: "bearing", label: "Bearing", of: (row: Throw): Value => row.target.azimuth_rad },
  { key: "along", label: "Along, m", of: (row: Throw): Value => row.measured_downrange_error_m },
  { key: "across", label: "Across, m", of: (row: Throw): Value => row.measured_crossrange_error_m },
  { key: "outcome", label: "Outcome", of: (row: Throw): Value => statusWord(row) },
  { key: "policy", label: "Policy", of: (row: Throw): Value => row.policy_id },
  { key: "person", label: "Person", of: (row: Throw): Value => row.operator },
] as const;

export type ColumnKey = (typeof COLUMNS)[number]["key"];
export type Order = { key: ColumnKey; isDescending: boolean } | null;

/** Ascending, descending, then as the server sent it. */
export function nextOrder(order: Order, key: ColumnKey): Order {
  if (order?.key !== key) return { key, isDescending: false };
  return order.isDescending ? null : { key, isDescending: true };
}

export function sortOf(order: Order, key: ColumnKey): "none" | "ascending" | "descending" {
  if (order?.key !== key) return "none";
  return order.isDescending ? "descending" : "ascending";
}

/** Rows without a value stand last in both directions. */
export function sorted(rows: readonly Throw[], order: Order): readonly Throw[] {
  const column = COLUMNS.find(({ key }) => key === order?.key);
  if (!order || !column) return rows;
  const sign = order.isDescending ? -1 : 1;
  return [...rows].sort((a, b) => {
    const [left, right] = [column.of(a), column.of(b)];
    if (left === null || right === null) return Number(left === null) - Number(right === null);
    if (left === right) return 0;
    return left < right ? -sign : sign;
  });
}
