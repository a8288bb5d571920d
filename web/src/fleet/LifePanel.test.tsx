import { cleanup, render, screen } from "@testing-library/react";
import { afterEach, describe, expect, it } from "vitest";
import type { Machine } from "../session/live";
import { LifePanel } from "./MachinePanels";
import type { MachineLife } from "./useFleet";

afterEach(cleanup);

const life = {
  counts: {
    enrolled_utc: "2026-05-01T10:00:00Z",
    throw_count: 41,
    landed_count: 40,
    aborted_count: 1,
    throwing_s: 130.0,
    start_count: 7,
    stop_count: 1,
    fault_count: 0,
  },
} as MachineLife;

const machine = (state: object | null) =>
  ({
    machine_id: "m001",
    site: "yard",
    state,
    lease: { holder: null },
    link: { is_connected: false, last_seen_utc: null },
  }) as Machine;

function shown(state: object | null): Record<string, string> {
  render(<LifePanel machine={machine(state)} life={life} />);
  const names = screen.getAllByRole("term").map((item) => item.textContent ?? "");
  const values = screen.getAllByRole("definition").map((item) => item.textContent ?? "");
  return Object.fromEntries(names.map((name, index) => [name, values[index] ?? ""]));
}

describe("what a machine has done", () => {
  it("has hours and counts", () => {
    const facts = shown({ payload_held: true, operating_s: 44_640, idle_s: 42_840 });
    expect(facts.Operating).toBe("12.4 h, idle 11.9 h");
    expect(facts.Throws).toBe("41: 40 landed, 1 aborted");
    expect(facts["Time in throws"]).toBe("2 min");
    expect(facts["Stops and faults"]).toBe("1 stop, 0 faults");
    expect(facts.Load).toBe("held");
  });

  it("does not make up hours that older software does not count", () => {
    expect(shown({ payload_held: false }).Operating).toBe("not known");
  });

  it("says of a machine that was never heard what is not known", () => {
    const facts = shown(null);
    expect([facts.Operating, facts.Load]).toEqual(["not known", "not known"]);
  });
});
