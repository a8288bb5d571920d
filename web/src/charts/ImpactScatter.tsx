import * as Plot from "@observablehq/plot";
import { useCallback } from "react";
import type { Schema } from "../session/client";
import { crossrangeWords, downrangeWords, metres } from "../words/format";
import { ellipsePoints } from "./ellipse";
import { toCsv } from "./export";
import { groupStyle } from "./groups";
import { PlotFigure } from "./PlotFigure";
import { symmetricLimit } from "./scale";

type Stats = Schema["ThrowStats"];
type Point = Schema["ScatterPoint"];
type Props = { stats: Stats; selected: string | null; onSelect: (throwId: string) => void };

/** Smallest half axis: below a handful of centimetres the survey's own error is seen. */
const LEAST_M = 0.05;
/** Fewer points have no ellipse: two always lie on a line. */
const ELLIPSE_LEAST_COUNT = 3;
const MARGIN = { marginTop: 24, marginRight: 14, marginBottom: 36, marginLeft: 44 };

/** Impacts around the target, equal axes, 1 sigma ellipse per group; hover gives the numbers. */
export function ImpactScatter({ stats, selected, onSelect }: Props) {
  const draw = useCallback(
    (width: number, height: number) => scatter(stats, selected, width, height),
    [stats, selected],
  );
  return (
    <PlotFigure
      title="Impacts in throw coordinates"
      note={`n = ${stats.points.length}${stats.is_truncated ? ", newest only" : ""}`}
      draw={draw}
      onPick={(value) => onSelect((value as Point).throw_id)}
      toCsv={() => pointsCsv(stats.points)}
    />
  );
}

function scatter(stats: Stats, selected: string | null, width: number, height: number) {
  const { points, groups } = stats;
  const inner = {
    width: width - MARGIN.marginLeft - MARGIN.marginRight,
    height: height - MARGIN.marginTop - MARGIN.marginBottom,
  };
  // Equal axes: the same metres per pixel both ways, so that circles stay round.
  const along_m = symmetricLimit(
    points.map((p) => p.downrange_error_m),
    LEAST_M,
  );
  const across_m = symmetricLimit(
    points.map((p) => p.crossrange_error_m),
    LEAST_M,
  );
  const perPixel = Math.max((2 * along_m) / inner.width, (2 * across_m) / inner.height);
  const x_m = (perPixel * inner.width) / 2;
  const y_m = (perPixel * inner.height) / 2;
  const style = (group: string) => groupStyle(groups, group);
  const chosen = points.filter((point) => point.throw_id === selected);
  return Plot.plot({
    width,
    height,
    ...MARGIN,
    style: { background: "transparent", fontSize: "11px", overflow: "visible" },
    x: {
      domain: [-x_m, x_m],
      label: "Along, m (+ long)",
      labelAnchor: "center",
      labelArrow: "none",
      ticks: 6,
      grid: true,
    },
    y: {
      domain: [-y_m, y_m],
      label: "Across, m (+ left)",
      labelArrow: "none",
      ticks: 6,
      grid: true,
    },
    symbol: { type: "identity" },
    marks: [
      Plot.ruleX([0], { stroke: "var(--line-strong)" }),
      Plot.ruleY([0], { stroke: "var(--line-strong)" }),
      Plot.dot(points, {
        x: "downrange_error_m",
        y: "crossrange_error_m",
        symbol: (point: Point) => style(point.group).symbol,
        stroke: (point: Point) => style(point.group).colour,
        fill: (point: Point) => style(point.group).colour,
        fillOpacity: 0.25,
        r: points.length > 300 ? 2 : 3.2,
      }),
      groups.flatMap((group) => {
        const outline = groupEllipse(group);
        if (!outline) return [];
        const { colour } = style(group.group);
        return [
          Plot.line(outline, { x: "x_m", y: "y_m", stroke: "var(--panel)", strokeWidth: 4 }),
          Plot.line(outline, { x: "x_m", y: "y_m", stroke: colour, strokeWidth: 2.2 }),
          Plot.dot([group], {
            x: "mean_downrange_error_m",
            y: "mean_crossrange_error_m",
            symbol: "plus",
            r: 7,
            stroke: colour,
            strokeWidth: 2.4,
          }),
        ];
      }),
      Plot.dot(chosen, {
        x: "downrange_error_m",
        y: "crossrange_error_m",
        r: 8,
        stroke: "var(--ink)",
        strokeWidth: 2,
      }),
      Plot.tip(
        points,
        Plot.pointer({
          x: "downrange_error_m",
          y: "crossrange_error_m",
          fill: "var(--panel)",
          stroke: "var(--line-strong)",
          title: (point: Point) =>
            `${downrangeWords(point.downrange_error_m)}\n${crossrangeWords(point.crossrange_error_m)}\ntarget ${metres(point.range_m)}`,
        }),
      ),
    ],
  });
}

function groupEllipse(group: Schema["GroupStats"]) {
  const { sd_downrange_m, sd_crossrange_m, correlation_ratio } = group;
  if (group.throw_count < ELLIPSE_LEAST_COUNT) return null;
  if (sd_downrange_m === null || sd_crossrange_m === null) return null;
  return ellipsePoints(
    { ...group, sd_downrange_m, sd_crossrange_m, correlation_ratio: correlation_ratio ?? 0 },
    1,
  );
}

function pointsCsv(points: readonly Point[]): string {
  return toCsv(
    ["throw_id", "group", "range_m", "downrange_error_m", "crossrange_error_m"],
    points.map((p) => [p.throw_id, p.group, p.range_m, p.downrange_error_m, p.crossrange_error_m]),
  );
}
