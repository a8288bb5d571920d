/** Rows of the fleet: live state and record of each machine together, filtered and sorted. */

import { type Alert, needsLook } from "../alerts/attention";
import type { Machine } from "../session/live";
import type { FleetRecord, MissFigures, ModeSummary } from "./useFleet";

export type FleetRow = {
  machine: Machine;
  record: FleetRecord | null;
  /** Open alerts, and how many of them call for a look. */
  open_count: number;
  calling_count: number;
};

export type SortKey = "machine" | "state" | "throw" | "accuracy" | "alerts";
export type Standing = "live" | "lost" | "stopped";
export type FleetSearch = { find?: string; standing?: Standing; sort?: SortKey; view?: "map" };

export const SORTS: Record<SortKey, string> = {
  machine: "By name",
  state: "By state",
  throw: "By last throw",
  accuracy: "By accuracy",
  alerts: "By alerts",
};
export const STANDINGS: Record<Standing, string> = {
  live: "Connected",
  lost: "Lost",
  stopped: "Stopped or fault",
};

const known = <T extends string>(value: unknown, all: Record<T, string>): T | undefined =>
  typeof value === "string" && Object.hasOwn(all, value) ? (value as T) : undefined;

/** Search part of the address to filters; anything unreadable is left out. */
export function parseFleetSearch(search: Record<string, unknown>): FleetSearch {
  const standing = known(search.standing, STANDINGS);
  const sort = known(search.sort, SORTS);
  const find = typeof search.find === "string" || typeof search.find === "number";
  return {
    ...(find && search.find !== "" && { find: String(search.find) }),
    ...(standing && { standing }),
    ...(sort && sort !== "machine" && { sort }),
    ...(search.view === "map" && { view: search.view }),
  };
}

export const isAlarm = (machine: Machine) =>
  machine.lamp === "stopped" || machine.lamp === "fault" || machine.is_stop_pending;

export function fleetRows(
  machines: Readonly<Record<string, Machine>>,
  records: readonly FleetRecord[],
  alerts: readonly Alert[],
  nowMs: number,
): FleetRow[] {
  const byId = new Map(records.map((record) => [record.machine_id, record]));
  return Object.values(machines).map((machine) => {
    const own = alerts.filter((alert) => alert.machine_id === machine.machine_id);
    return {
      machine,
      record: byId.get(machine.machine_id) ?? null,
      open_count: own.length,
      calling_count: own.filter((alert) => needsLook(alert, nowMs)).length,
    };
  });
}

function hasWords({ machine, record }: FleetRow, find: string): boolean {
  const versions = record?.modes.map((mode) => mode.policy_id ?? "") ?? [];
  const texts = [machine.machine_id, machine.name, ...(record?.tags ?? []), ...versions];
  const all = texts.join("\n").toLowerCase();
  return find
    .toLowerCase()
    .split(/\s+/)
    .every((word) => all.includes(word));
}

function hasStanding({ machine }: FleetRow, standing: Standing): boolean {
  if (standing === "live") return machine.link.is_connected;
  if (standing === "lost") return !machine.link.is_connected;
  return isAlarm(machine);
}

/** Larger comes first: what needs a person. */
function urgency({ machine }: FleetRow): number {
  if (isAlarm(machine)) return 2;
  return machine.link.is_connected ? 0 : 1;
}

/** The larger mean miss of the modes; a machine without measured throws comes last. */
const worst = (row: FleetRow) =>
  Math.max(-1, ...(row.record?.modes.map((mode) => mode.recent?.mean_miss_m ?? -1) ?? []));

const COMPARE: Record<SortKey, (a: FleetRow, b: FleetRow) => number> = {
  machine: () => 0,
  state: (a, b) => urgency(b) - urgency(a),
  throw: (a, b) =>
    (b.record?.last_throw?.throw_id ?? "").localeCompare(a.record?.last_throw?.throw_id ?? ""),
  accuracy: (a, b) => worst(b) - worst(a),
  alerts: (a, b) => b.calling_count - a.calling_count || b.open_count - a.open_count,
};

export function chosenRows(rows: readonly FleetRow[], search: FleetSearch): FleetRow[] {
  const { find = "", standing, sort = "machine" } = search;
  return rows
    .filter((row) => hasWords(row, find) && (!standing || hasStanding(row, standing)))
    .sort(
      (a, b) => COMPARE[sort](a, b) || a.machine.machine_id.localeCompare(b.machine.machine_id),
    );
}

/**
 * Whether the recent mean miss is larger than at first by more than twice its standard error: a hint for the
 * eye, no test.
 */
export function isWorse(mode: ModeSummary): boolean {
  const { recent, baseline } = mode;
  if (!recent || !baseline) return false;
  const error_m = Math.hypot(meanError(recent), meanError(baseline));
  return recent.mean_miss_m - baseline.mean_miss_m > 2 * error_m;
}

/** Standard error of the mean of misses, from the spread of both directions. */
function meanError(figures: MissFigures): number {
  const { sd_downrange_m: along, sd_crossrange_m: across, throw_count } = figures;
  return Math.hypot(along ?? 0, across ?? 0) / Math.sqrt(Math.max(1, throw_count));
}
