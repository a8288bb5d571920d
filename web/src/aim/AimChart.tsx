import * as Plot from "@observablehq/plot";
import { useCallback } from "react";
import { toCsv } from "../charts/export";
import { PlotFigure } from "../charts/PlotFigure";
import { LEAST_MISS_M, symmetricLimit } from "../charts/scale";
import { signed } from "../words/format";
import type { Proposal } from "./useAim";

type Axis = "downrange" | "crossrange";
type Point = { range_m: number; miss_m: number; half_m: number };

const NAMES: Record<Axis, { title: string; label: string }> = {
  downrange: { title: "Mean miss along", label: "Along, m (+ long)" },
  crossrange: { title: "Mean miss across", label: "Across, m (+ left)" },
};
/** Standard deviations of a 90 % interval. */
const HALF_SIGMAS = 1.645;

/** Of the axis on both sides of the ranges, m. */
const AROUND_M = 0.5;

/** Mean miss over the range with its 90 % interval; the aim is moved by as much the other way. */
export function AimChart({ content, axis }: { content: Proposal; axis: Axis }) {
  const draw = useCallback(
    (width: number, height: number) => drawn(pointsOf(content, axis), axis, width, height),
    [content, axis],
  );
  return (
    <PlotFigure
      title={NAMES[axis].title}
      note="mean, 90 % interval"
      draw={draw}
      toCsv={() =>
        toCsv(
          ["range_m", `mean_${axis}_miss_m`, "half_interval_m"],
          pointsOf(content, axis).map((p) => [p.range_m, p.miss_m, p.half_m]),
        )
      }
    />
  );
}

export function pointsOf(content: Proposal, axis: Axis): Point[] {
  const { table } = content;
  const sd = content[`${axis}_sd_m`];
  return table.range_m.map((range_m, index) => ({
    range_m,
    miss_m: table[`${axis}_m`][index] ?? 0,
    half_m: HALF_SIGMAS * (sd[index] ?? 0),
  }));
}

function drawn(points: readonly Point[], axis: Axis, width: number, height: number) {
  const ends_m = points.flatMap((p) => [p.miss_m - p.half_m, p.miss_m + p.half_m]);
  const ranges_m = points.map((p) => p.range_m);
  const limit_m = symmetricLimit(ends_m, LEAST_MISS_M);
  return Plot.plot({
    width,
    height,
    marginTop: 24,
    marginRight: 14,
    marginBottom: 36,
    marginLeft: 44,
    style: { background: "transparent", fontSize: "11px", overflow: "visible" },
    x: {
      label: "Target range, m",
      // A machine that threw at one range has one point.
      domain: [Math.min(...ranges_m) - AROUND_M, Math.max(...ranges_m) + AROUND_M],
      labelAnchor: "center",
      labelArrow: "none",
      ticks: 6,
    },
    y: {
      label: NAMES[axis].label,
      domain: [-limit_m, limit_m],
      labelArrow: "none",
      nice: true,
      grid: true,
      ticks: 5,
    },
    marks: [
      Plot.ruleY([0], { stroke: "var(--line-strong)" }),
      Plot.areaY(points, {
        x: "range_m",
        y1: (p: Point) => p.miss_m - p.half_m,
        y2: (p: Point) => p.miss_m + p.half_m,
        fill: "var(--chart-1)",
        fillOpacity: 0.25,
      }),
      Plot.line(points, { x: "range_m", y: "miss_m", stroke: "var(--chart-1)", strokeWidth: 2 }),
      Plot.ruleX(points, {
        x: "range_m",
        y1: (p: Point) => p.miss_m - p.half_m,
        y2: (p: Point) => p.miss_m + p.half_m,
        stroke: "var(--chart-1)",
        strokeOpacity: 0.5,
      }),
      Plot.dot(points, { x: "range_m", y: "miss_m", fill: "var(--chart-1)", r: 2.6 }),
      Plot.tip(
        points,
        Plot.pointer({
          x: "range_m",
          y: "miss_m",
          fill: "var(--panel)",
          stroke: "var(--line-strong)",
          title: (p: Point) =>
            `${p.range_m.toFixed(2)} m\n${signed(p.miss_m)} m ± ${p.half_m.toFixed(2)} m`,
        }),
      ),
    ],
  });
}
