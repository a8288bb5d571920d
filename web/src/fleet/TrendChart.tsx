import * as Plot from "@observablehq/plot";
import { useCallback } from "react";
import { toCsv } from "../charts/export";
import { PlotFigure } from "../charts/PlotFigure";
import { LEAST_MISS_M, symmetricLimit } from "../charts/scale";
import { signed } from "../words/format";
import { localStamp, shortStamp, zoneName } from "../words/time";
import { type Axis, medians, type TrendPoint, type Version } from "./trend";

const LABELS: Record<Axis, string> = {
  downrange: "Along, m (+ long)",
  crossrange: "Across, m (+ left)",
};

type Props = {
  axis: Axis;
  points: readonly TrendPoint[];
  versions: readonly Version[];
  note: string;
};

/** Every measured miss in the order of the throws, its running median, and where the version changed. */
export function TrendChart({ axis, points, versions, note }: Props) {
  const draw = useCallback(
    (width: number, height: number) => trend(axis, points, versions, width, height),
    [axis, points, versions],
  );
  return (
    <PlotFigure
      title={axis === "downrange" ? "Miss along over time" : "Miss across over time"}
      note={note}
      draw={draw}
      toCsv={() =>
        toCsv(
          ["throw_id", "created_utc", "mode", "range_m", "downrange_error_m", "crossrange_error_m"],
          points.map((p) => [
            p.throw_id,
            p.created_utc,
            p.mode,
            p.range_m,
            p.downrange_error_m,
            p.crossrange_error_m,
          ]),
        )
      }
    />
  );
}

function trend(
  axis: Axis,
  points: readonly TrendPoint[],
  versions: readonly Version[],
  width: number,
  height: number,
) {
  const value = (point: TrendPoint) => point[`${axis}_error_m`];
  const limit_m = symmetricLimit(points.map(value), LEAST_MISS_M);
  const time = (point: TrendPoint) => new Date(point.created_utc);
  return Plot.plot({
    width,
    height,
    marginTop: 24,
    marginRight: 14,
    marginBottom: 44,
    marginLeft: 44,
    style: { background: "transparent", fontSize: "11px", overflow: "visible" },
    x: {
      type: "time",
      label: zoneName(new Date()),
      labelArrow: "none",
      inset: 12,
      ticks: Math.max(2, Math.floor(width / 110)),
      tickFormat: (date: Date) => shortStamp(date.toISOString()).slice(0, 11).replace(" ", "\n"),
    },
    y: {
      label: LABELS[axis],
      domain: [-limit_m, limit_m],
      labelArrow: "none",
      nice: true,
      grid: true,
      ticks: 5,
    },
    marks: [
      Plot.ruleY([0], { stroke: "var(--line-strong)" }),
      Plot.ruleX(versions, {
        x: (version: Version) => new Date(version.since_utc),
        stroke: "var(--look-mark)",
        strokeDasharray: "4 3",
      }),
      Plot.text(versions, {
        x: (version: Version) => new Date(version.since_utc),
        text: (version: Version) => version.policy_id ?? "none",
        frameAnchor: "top",
        dx: 4,
        textAnchor: "start",
        fill: "var(--ink-dim)",
      }),
      Plot.dot(points, { x: time, y: value, fill: "var(--chart-1)", fillOpacity: 0.55, r: 2.6 }),
      Plot.line(medians(points, axis), {
        x: "time",
        y: "value_m",
        stroke: "var(--chart-2)",
        strokeWidth: 2,
      }),
      Plot.tip(
        points,
        Plot.pointer({
          x: time,
          y: value,
          fill: "var(--panel)",
          stroke: "var(--line-strong)",
          title: (point: TrendPoint) =>
            `${localStamp(point.created_utc)}\n${point.range_m.toFixed(2)} m\n${signed(value(point))} m`,
        }),
      ),
    ],
  });
}
