/** How time series look: uPlot's options, in the console's colours. */

import type uPlot from "uplot";
import { fixed } from "../words/format";

export type Line = {
  label: string;
  values: readonly (number | null)[];
  /** Name of a colour token. */
  colour: string;
  isDashed?: boolean;
};

export type Band = { name: string; start_s: number; end_s: number };

const SYNC_KEY = "throw";
const FONT = '11px "Inter Variable", system-ui, sans-serif';

/** A canvas knows no CSS variables. */
export function token(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim() || "#888";
}

export function plotOptions(
  lines: readonly Line[],
  unit: string,
  width: number,
  height: number,
): uPlot.Options {
  const axis: uPlot.Axis = {
    stroke: token("--ink-dim"),
    font: FONT,
    grid: { stroke: token("--chart-grid"), width: 1 },
    ticks: { stroke: token("--chart-grid"), width: 1, size: 4 },
  };
  return {
    width,
    height: height - 20,
    cursor: { sync: { key: SYNC_KEY }, drag: { x: true, y: false }, points: { size: 6 } },
    legend: { live: true },
    scales: { x: { time: false }, y: { range: paddedRange } },
    axes: [
      { ...axis, size: 24, values: (_, ticks) => ticks.map((t) => `${t}`) },
      { ...axis, size: 44 },
    ],
    series: [
      { label: "t, s", value: (_, value) => fixed(value, 2) },
      ...lines.map((line) => ({
        label: line.label,
        stroke: token(line.colour),
        width: 1.5,
        dash: line.isDashed ? [5, 4] : undefined,
        points: { show: false },
        value: (_: uPlot, value: number | null) => `${fixed(value, 3)} ${unit}`,
      })),
    ],
  };
}

/** Always holds zero, so that signs are read from the position. */
function paddedRange(_: uPlot, low: number | null, high: number | null): [number, number] {
  const least = Math.min(low ?? 0, 0);
  const most = Math.max(high ?? 0, 0);
  const room = Math.max(most - least, 1e-3) * 0.08;
  return [least - (least < 0 ? room : 0), most + (most > 0 ? room : 0)];
}

/** Phases behind the lines, every other one shaded, and the zero line. */
export function bandPlugin(bands: readonly Band[]): uPlot.Plugin {
  return {
    hooks: {
      drawClear: (plot) => {
        const { ctx, bbox } = plot;
        ctx.save();
        ctx.fillStyle = token("--panel-raised");
        bands
          .filter((band) => band.name !== "flight")
          .forEach((band, index) => {
            if (index % 2 === 1) return;
            const from = Math.max(bbox.left, plot.valToPos(band.start_s, "x", true));
            const to = Math.min(bbox.left + bbox.width, plot.valToPos(band.end_s, "x", true));
            if (to > from) ctx.fillRect(from, bbox.top, to - from, bbox.height);
          });
        ctx.strokeStyle = token("--line-strong");
        const zero = Math.round(plot.valToPos(0, "y", true)) + 0.5;
        ctx.beginPath();
        ctx.moveTo(bbox.left, zero);
        ctx.lineTo(bbox.left + bbox.width, zero);
        ctx.stroke();
        ctx.restore();
      },
    },
  };
}
