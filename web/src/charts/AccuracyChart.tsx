import * as Plot from "@observablehq/plot";
import { useCallback } from "react";
import type { Schema } from "../session/client";
import { fixed, signed } from "../words/format";
import { toCsv } from "./export";
import { groupStyle } from "./groups";
import { PlotFigure } from "./PlotFigure";

type Stats = Schema["ThrowStats"];
type Bin = Schema["RangeStats"];
type Axis = "downrange" | "crossrange";

const NAMES: Record<Axis, { title: string; label: string }> = {
  downrange: { title: "Accuracy along against range", label: "Along, m (+ long)" },
  crossrange: { title: "Accuracy across against range", label: "Across, m (+ left)" },
};

/** Mean and standard deviation of the error against target range, per group; n stands in the hover. */
export function AccuracyChart({ stats, axis }: { stats: Stats; axis: Axis }) {
  const draw = useCallback(
    (width: number, height: number) => accuracy(stats, axis, width, height),
    [stats, axis],
  );
  return (
    <PlotFigure
      title={NAMES[axis].title}
      note="mean ± 1 sd"
      draw={draw}
      toCsv={() => binsCsv(stats.by_range)}
    />
  );
}

function accuracy(stats: Stats, axis: Axis, width: number, height: number) {
  const { by_range: bins, groups } = stats;
  const mean = (bin: Bin) => bin[`mean_${axis}_error_m`];
  const sd = (bin: Bin) => bin[`sd_${axis}_m`] ?? 0;
  const colour = (bin: Bin) => groupStyle(groups, bin.group).colour;
  const least = 0.1;
  const low = Math.min(-least, ...bins.map((bin) => mean(bin) - sd(bin)));
  const high = Math.max(least, ...bins.map((bin) => mean(bin) + sd(bin)));
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
      labelAnchor: "center",
      labelArrow: "none",
      nice: true,
      inset: 12,
      ticks: 6,
      tickFormat: (range_m: number) => String(Number(range_m.toFixed(2))),
    },
    y: {
      label: NAMES[axis].label,
      labelArrow: "none",
      domain: [low, high],
      nice: true,
      grid: true,
      ticks: 5,
    },
    symbol: { type: "identity" },
    marks: [
      Plot.ruleY([0], { stroke: "var(--line-strong)" }),
      Plot.line(bins, { x: "range_m", y: mean, z: "group", stroke: colour, strokeOpacity: 0.5 }),
      Plot.ruleX(bins, {
        x: "range_m",
        y1: (bin: Bin) => mean(bin) - sd(bin),
        y2: (bin: Bin) => mean(bin) + sd(bin),
        stroke: colour,
        strokeWidth: 2,
      }),
      Plot.dot(bins, {
        x: "range_m",
        y: mean,
        symbol: (bin: Bin) => groupStyle(groups, bin.group).symbol,
        fill: colour,
        r: 3.6,
      }),
      Plot.tip(
        bins,
        Plot.pointer({
          x: "range_m",
          y: mean,
          fill: "var(--panel)",
          stroke: "var(--line-strong)",
          title: (bin: Bin) =>
            `${fixed(bin.range_m)} m, n = ${bin.throw_count}\nmean ${signed(mean(bin))} m\nsd ${fixed(sd(bin))} m`,
        }),
      ),
    ],
  });
}

function binsCsv(bins: readonly Bin[]): string {
  return toCsv(
    [
      "group",
      "range_m",
      "throw_count",
      "mean_downrange_error_m",
      "sd_downrange_m",
      "mean_crossrange_error_m",
      "sd_crossrange_m",
    ],
    bins.map((bin) => [
      bin.group,
      bin.range_m,
      bin.throw_count,
      bin.mean_downrange_error_m,
      bin.sd_downrange_m,
      bin.mean_crossrange_error_m,
      bin.sd_crossrange_m,
    ]),
  );
}
