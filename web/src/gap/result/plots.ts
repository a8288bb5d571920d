/** Series of a diagnosis for the charts: measured, twin before, twin after, and what is left of each. */

import { VOCABULARY } from "../../api/vocabulary";
import type { Line } from "../../charts/seriesPlot";

export type Overlay = {
  name: string;
  /** What is shown together: the name up to its first comma. */
  group: string;
  unit: string;
  x: readonly number[];
  lines: readonly Line[];
  /** Measured minus twin, before and after. */
  left: readonly Line[];
  /** Which throw it shows, and when that was; null where the diagnosis did not keep it. */
  throwId: string | null;
  thrownUtc: string | null;
};

type Values = (number | null)[];

/** Overlays of all plots that have a time axis and at least one series of its length. */
export function overlaysOf(plots: Record<string, unknown>): Overlay[] {
  return Object.entries(plots).flatMap(([name, plot]) => {
    const found = overlayOf(name.replaceAll("_", " "), plot);
    return found ? [found] : [];
  });
}

function overlayOf(name: string, plot: unknown): Overlay | null {
  if (typeof plot !== "object" || plot === null) return null;
  const fields = plot as Record<string, unknown>;
  const x = numbers(fields.x).filter((value) => value !== null);
  if (x.length < 2) return null;
  const pick = (names: readonly string[]) => {
    const key = names.find((other) => numbers(fields[other]).length === x.length);
    return key ? numbers(fields[key]) : null;
  };
  const measured = pick(VOCABULARY.series.measured);
  const before = pick(VOCABULARY.series.twin_before);
  const after = pick(VOCABULARY.series.twin_after);
  const lines = [
    ...line("measured", measured, "--ink"),
    ...line("before", before, "--chart-2", true),
    ...line("after", after, "--chart-1"),
  ];
  if (lines.length === 0) return null;
  return {
    name,
    group: name.split(",")[0] ?? name,
    unit: typeof fields.unit === "string" ? fields.unit : "",
    x,
    lines,
    left: [
      ...line("before", minus(measured, before), "--chart-2", true),
      ...line("after", minus(measured, after), "--chart-1"),
    ],
    throwId: typeof fields.throw_id === "string" ? fields.throw_id : null,
    thrownUtc: typeof fields.thrown_utc === "string" ? fields.thrown_utc : null,
  };
}

function line(label: string, values: Values | null, colour: string, isDashed = false): Line[] {
  return values ? [{ label, values, colour, isDashed }] : [];
}

function minus(measured: Values | null, twin: Values | null): Values | null {
  if (!measured || !twin) return null;
  return measured.map((value, index) => {
    const other = twin[index];
    return value === null || other === null || other === undefined ? null : value - other;
  });
}

function numbers(value: unknown): Values {
  if (!Array.isArray(value)) return [];
  return value.map((item) => (typeof item === "number" && Number.isFinite(item) ? item : null));
}
