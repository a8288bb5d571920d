/** Filters of the history, to and from the address of the page; anything unreadable is left out. */

import type { paths } from "../api/schema";
import { dayStart } from "../words/time";
import { OUTCOMES, type Outcome } from "./outcome";

export type GroupBy = "policy" | "mode" | "machine" | "operator";

export type Filters = {
  machine?: string;
  mode?: "2d" | "3d";
  policy?: string;
  operator?: string;
  outcome?: Outcome;
  /** Target range, m. */
  min?: number;
  max?: number;
  /** Days of the chosen time zone, inclusive: "2026-11-21". */
  since?: string;
  until?: string;
};

export type ThrowsSearch = Filters & { group?: GroupBy; cursor?: string };

export type ThrowQuery = NonNullable<paths["/api/v1/throws"]["get"]["parameters"]["query"]>;

const GROUPS: readonly GroupBy[] = ["policy", "mode", "machine", "operator"];
const DAY = /^\d{4}-\d{2}-\d{2}$/;

function text(value: unknown): string | undefined {
  const found = typeof value === "number" ? String(value) : value;
  return typeof found === "string" && found !== "" ? found : undefined;
}

function distance(value: unknown): number | undefined {
  const found = typeof value === "string" && value !== "" ? Number(value) : value;
  return typeof found === "number" && Number.isFinite(found) && found >= 0 ? found : undefined;
}

function oneOf<T extends string>(value: unknown, allowed: readonly T[]): T | undefined {
  return allowed.find((candidate) => candidate === value);
}

function day(value: unknown): string | undefined {
  const found = text(value);
  return found && DAY.test(found) && !Number.isNaN(Date.parse(found)) ? found : undefined;
}

/** Search part of the address to filters. */
export function parseSearch(search: Record<string, unknown>): ThrowsSearch {
  const parsed: ThrowsSearch = {
    machine: text(search.machine),
    mode: oneOf(search.mode, ["2d", "3d"]),
    policy: text(search.policy),
    operator: text(search.operator),
    outcome: oneOf(search.outcome, OUTCOMES),
    min: distance(search.min),
    max: distance(search.max),
    since: day(search.since),
    until: day(search.until),
    group: oneOf(search.group, GROUPS),
    cursor: text(search.cursor),
  };
  return Object.fromEntries(
    Object.entries(parsed).filter(([, value]) => value !== undefined),
  ) as ThrowsSearch;
}

/** Filters to what the server asks for. */
export function toQuery(filters: Filters): ThrowQuery {
  return {
    machine_id: filters.machine,
    mode: filters.mode,
    policy_sha256: filters.policy,
    operator: filters.operator,
    outcome: filters.outcome,
    min_range_m: filters.min,
    max_range_m: filters.max,
    since: filters.since && dayStart(filters.since),
    until: filters.until && dayStart(filters.until, true),
  };
}

/** Address of the server's CSV with the same filters. */
export function csvHref(filters: Filters): string {
  const query = new URLSearchParams();
  for (const [key, value] of Object.entries(toQuery(filters))) {
    if (value !== undefined && value !== null && value !== "") query.set(key, String(value));
  }
  const tail = query.toString();
  return `/api/v1/throws/export.csv${tail ? `?${tail}` : ""}`;
}

export const isFiltered = (filters: Filters): boolean =>
  Object.values(toQuery(filters)).some((value) => value !== undefined && value !== "");
