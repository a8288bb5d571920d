import { describe, expect, it } from "vitest";
import { panelsOf, phaseAt } from "./panels";

const base = {
  throw_id: "t1",
  t_s: [0, 0.01],
  phases: [],
  release_s: null,
  impact_s: null,
  ball_t_s: [],
  ball_position_m: [],
};

describe("panels of a throw", () => {
  it("put commanded beside measured, requested beside applied", () => {
    const columns = {
      boom_velocity_rad_per_s: [0, 1],
      boom_velocity_reference_rad_per_s: [0, 1],
      boom_valve_requested_ratio: [0, 1],
      boom_valve_applied_ratio: [0, 0.5],
      telescope_velocity_m_per_s: [0, 1],
    };
    const panels = panelsOf({ ...base, columns }, "velocity");
    expect(panels.map((panel) => panel.id)).toEqual([
      "boom-velocity",
      "boom-valve",
      "telescope-velocity",
    ]);
    expect(panels[0]?.lines.map((line) => line.label)).toEqual(["commanded", "measured"]);
    expect(panels[2]?.unit).toBe("m/s");
  });

  it("leave out what the log does not hold", () => {
    expect(panelsOf({ ...base, columns: {} }, "velocity")).toEqual([]);
  });

  it("show pressure in MPa", () => {
    const [panel] = panelsOf(
      { ...base, columns: { supply_pressure_pa: [21e6, null] } },
      "position",
    );
    expect(panel?.lines[0]?.values).toEqual([21, null]);
  });
});

describe("the phase at a time", () => {
  const bands = [
    { name: "swing", start_s: 0, end_s: 1 },
    { name: "flight", start_s: 0.9, end_s: 2 },
    { name: "settling", start_s: 1, end_s: 1.5 },
  ];

  it("is that of the moment, with the flight beside it", () => {
    expect(phaseAt(bands, 0.5)).toBe("swing");
    expect(phaseAt(bands, 1.2)).toBe("flight, settling");
    expect(phaseAt(bands, 1.8)).toBe("flight");
    expect(phaseAt(bands, 2.5)).toBe("");
  });

  it("is the newer one where one ends and the next begins", () => {
    expect(phaseAt(bands, 1)).toBe("flight, settling");
  });
});
