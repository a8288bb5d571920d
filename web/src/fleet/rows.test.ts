import { describe, expect, it } from "vitest";
import type { Alert } from "../alerts/attention";
import type { Machine } from "../session/live";
import { chosenRows, fleetRows, isWorse, parseFleetSearch } from "./rows";
import type { FleetRecord, MissFigures, ModeSummary } from "./useFleet";

const NOW = Date.parse("2026-11-27T12:00:00Z");

function machine(id: string, changes: Partial<Machine> = {}): Machine {
  return {
    machine_id: id,
    name: "",
    lamp: "disarmed",
    is_stop_pending: false,
    link: { is_connected: true },
    ...changes,
  } as Machine;
}

const LOST: Partial<Machine> = {
  lamp: "lost",
  link: { is_connected: false } as Machine["link"],
};

const figures = (mean_miss_m: number, throw_count = 20, sd = 0.1): MissFigures => ({
  throw_count,
  mean_downrange_error_m: 0,
  mean_crossrange_error_m: 0,
  sd_downrange_m: sd,
  sd_crossrange_m: sd,
  mean_miss_m,
});

const mode = (recent: MissFigures | null, baseline: MissFigures | null = null): ModeSummary => ({
  mode: "2d",
  policy_id: "m545-2d-v7",
  policy_sha256: "a",
  since_utc: null,
  recent,
  baseline,
});

function record(id: string, tags: string[] = [], modes: ModeSummary[] = []): FleetRecord {
  return { machine_id: id, tags, throw_count: 0, last_throw: null, modes };
}

const byId = (...machines: Machine[]) =>
  Object.fromEntries(machines.map((one) => [one.machine_id, one]));

const ids = (rows: ReturnType<typeof chosenRows>) => rows.map((row) => row.machine.machine_id);

describe("rows of the fleet", () => {
  const alert = (id: string, seen: string | null) =>
    ({
      alert_id: `${id}${seen}`,
      rule: "lost",
      machine_id: id,
      cleared_utc: null,
      acknowledged_by: seen,
      silenced_until_utc: null,
    }) as Alert;
  const all = fleetRows(
    byId(machine("m002"), machine("m001", LOST), machine("m003", { lamp: "fault" })),
    [
      record("m001", ["north"], [mode(figures(0.4))]),
      record("m002", [], [mode(figures(0.5)), mode(null)]),
    ],
    [alert("m001", null), alert("m001", "ada"), alert("m002", "ada")],
    NOW,
  );

  it("never hides a lost machine, and counts its alerts", () => {
    expect(ids(chosenRows(all, {}))).toEqual(["m001", "m002", "m003"]);
    const lost = all.find((row) => row.machine.machine_id === "m001");
    expect([lost?.open_count, lost?.calling_count]).toEqual([2, 1]);
  });

  it("shows a machine that the server's records do not have yet", () => {
    expect(all.find((row) => row.machine.machine_id === "m003")?.record).toBeNull();
  });

  it("finds by name, tag and version, all words", () => {
    expect(ids(chosenRows(all, { find: "NORTH" }))).toEqual(["m001"]);
    expect(ids(chosenRows(all, { find: "2d-v7 m002" }))).toEqual(["m002"]);
    expect(ids(chosenRows(all, { find: "south" }))).toEqual([]);
  });

  it("chooses by state", () => {
    expect(ids(chosenRows(all, { standing: "lost" }))).toEqual(["m001"]);
    expect(ids(chosenRows(all, { standing: "stopped" }))).toEqual(["m003"]);
    expect(ids(chosenRows(all, { standing: "live" }))).toEqual(["m002", "m003"]);
  });

  it("sorts what needs a person to the front", () => {
    expect(ids(chosenRows(all, { sort: "state" }))).toEqual(["m003", "m001", "m002"]);
    expect(ids(chosenRows(all, { sort: "alerts" }))).toEqual(["m001", "m002", "m003"]);
    expect(ids(chosenRows(all, { sort: "accuracy" }))).toEqual(["m002", "m001", "m003"]);
  });

  it("keeps in the address what it knows", () => {
    expect(parseFleetSearch({ find: "x", standing: "lost", sort: "alerts" })).toEqual({
      find: "x",
      standing: "lost",
      sort: "alerts",
    });
    expect(parseFleetSearch({ find: "", standing: "toString", sort: "machine" })).toEqual({});
    expect(parseFleetSearch({ find: 12 })).toEqual({ find: "12" });
  });
});

describe("recent throws beside the first", () => {
  it("calls a difference within chance no difference", () => {
    expect(isWorse(mode(figures(0.2)))).toBe(false);
    expect(isWorse(mode(figures(0.22), figures(0.2, 50)))).toBe(false);
    expect(isWorse(mode(figures(0.4), figures(0.2, 50)))).toBe(true);
    expect(isWorse(mode(figures(0.1), figures(0.4, 50)))).toBe(false);
    expect(isWorse(mode(figures(0.4, 2, 0.3), figures(0.2, 50)))).toBe(false);
  });
});
