/** Which columns of a throw's log stand in which chart. */

import type { Band, Line } from "../charts/seriesPlot";
import type { Schema } from "../session/client";

type Series = Schema["ThrowSeries"];

export type Panel = { id: string; title: string; unit: string; lines: Line[] };
export type Quantity = "velocity" | "position";

const JOINTS = ["slew", "boom", "dipper", "telescope"] as const;
type Joint = (typeof JOINTS)[number];

const unitOf = (joint: Joint) => (joint === "telescope" ? "m" : "rad");
const title = (joint: string) => `${joint[0]?.toUpperCase()}${joint.slice(1)}`;

type Wanted = { label: string; column: string; colour: string; isDashed?: boolean };

function pick(series: Series, wanted: readonly Wanted[]): Line[] {
  return wanted.flatMap(({ label, column, colour, isDashed }) => {
    const values = series.columns[column];
    return values ? [{ label, values, colour, isDashed }] : [];
  });
}

function velocity(series: Series, joint: Joint): Panel {
  const unit = unitOf(joint);
  return {
    id: `${joint}-velocity`,
    title: `${title(joint)} velocity`,
    unit: `${unit}/s`,
    lines: pick(series, [
      {
        label: "commanded",
        column: `${joint}_velocity_reference_${unit}_per_s`,
        colour: "--chart-2",
        isDashed: true,
      },
      { label: "measured", column: `${joint}_velocity_${unit}_per_s`, colour: "--chart-1" },
    ]),
  };
}

function position(series: Series, joint: Joint): Panel {
  const unit = unitOf(joint);
  return {
    id: `${joint}-position`,
    title: `${title(joint)} position`,
    unit,
    lines: pick(series, [
      {
        label: "sensor",
        column: `${joint}_sensor_position_${unit}`,
        colour: "--chart-2",
        isDashed: true,
      },
      { label: "estimate", column: `${joint}_position_${unit}`, colour: "--chart-1" },
    ]),
  };
}

function valve(series: Series, joint: Joint): Panel {
  return {
    id: `${joint}-valve`,
    title: `${title(joint)} valve`,
    unit: "ratio",
    lines: pick(series, [
      {
        label: "requested",
        column: `${joint}_valve_requested_ratio`,
        colour: "--chart-2",
        isDashed: true,
      },
      { label: "applied", column: `${joint}_valve_applied_ratio`, colour: "--chart-1" },
    ]),
  };
}

function swing(series: Series): Panel {
  return {
    id: "swing",
    title: "Gripper swing",
    unit: "rad",
    lines: pick(series, [
      { label: "in the arm plane", column: "swing_rad", colour: "--chart-1" },
      { label: "across", column: "roll_swing_rad", colour: "--chart-2", isDashed: true },
    ]),
  };
}

function supply(series: Series): Panel {
  const pressure = series.columns.supply_pressure_pa;
  const lines = pressure
    ? [
        {
          label: "supply",
          values: pressure.map((value) => (value === null ? null : value / 1e6)),
          colour: "--chart-1",
        },
      ]
    : [];
  return { id: "supply", title: "Supply pressure", unit: "MPa", lines };
}

/** Commanded and measured joints beside requested and applied valves, then swing and supply. */
export function panelsOf(series: Series, quantity: Quantity): Panel[] {
  const joint = quantity === "velocity" ? velocity : position;
  const rows = JOINTS.flatMap((name) => [joint(series, name), valve(series, name)]);
  return [swing(series), supply(series), ...rows].filter((panel) => panel.lines.length > 0);
}

/** Phase at a time of the replay, and that the load flies: "settling, flight"; empty outside of all. */
export const phaseAt = (bands: readonly Band[], at_s: number): string =>
  bands
    .filter((band) => band.start_s <= at_s && at_s <= band.end_s)
    // Where one ends and the next begins the newer counts.
    .filter((band, index, all) => band.name === "flight" || !startsLater(all.slice(index + 1)))
    .map((band) => band.name)
    .join(", ");

const startsLater = (bands: readonly Band[]) => bands.some((band) => band.name !== "flight");
