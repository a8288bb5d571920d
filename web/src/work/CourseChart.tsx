import * as Plot from "@observablehq/plot";
import { useCallback } from "react";
import { toCsv } from "../charts/export";
import { PlotFigure } from "../charts/PlotFigure";
import { fixed } from "../words/format";
import type { Job } from "./job";
import { type CoursePoint, courseOf } from "./words";

/** Share filled and share spilled after each load. */
export function CourseChart({ job }: { job: Job }) {
  const points = courseOf(job);
  const key = JSON.stringify(points);
  // biome-ignore lint/correctness/useExhaustiveDependencies: the points follow from the key
  const draw = useCallback((width: number, height: number) => drawn(points, width, height), [key]);
  return (
    <PlotFigure
      title="Course"
      note="spilled dashed"
      draw={draw}
      toCsv={() =>
        toCsv(
          ["load", "filled_percent", "spilled_percent"],
          points.map((point) => [point.load, point.filled, point.spilled]),
        )
      }
    />
  );
}

function drawn(points: readonly CoursePoint[], width: number, height: number) {
  const last = points.at(-1)?.load ?? 0;
  return Plot.plot({
    width,
    height,
    marginTop: 24,
    marginRight: 14,
    marginBottom: 34,
    marginLeft: 44,
    style: { background: "transparent", fontSize: "11px", overflow: "visible" },
    x: {
      label: "Load",
      labelAnchor: "center",
      labelArrow: "none",
      domain: [0, Math.max(5, last)],
      ticks: Math.min(8, Math.max(5, last)),
      tickFormat: "d",
    },
    y: {
      label: "% of the volume",
      labelArrow: "none",
      domain: [0, Math.max(100, ...points.map((point) => point.filled))],
      grid: true,
      ticks: 4,
    },
    marks: [
      Plot.line(points, { x: "load", y: "filled", stroke: "var(--ink)", strokeWidth: 2 }),
      Plot.dot(points, { x: "load", y: "filled", fill: "var(--ink)", r: 2.5 }),
      Plot.line(points, {
        x: "load",
        y: "spilled",
        stroke: "var(--chart-2)",
        strokeDasharray: "6 4",
        strokeWidth: 2,
      }),
      Plot.tip(
        points,
        Plot.pointerX({
          x: "load",
          y: "filled",
          fill: "var(--panel)",
          stroke: "var(--line-strong)",
          title: (point: CoursePoint) =>
            `after load ${point.load}\nfilled ${fixed(point.filled, 1)} %\nspilled ${fixed(point.spilled, 1)} %`,
        }),
      ),
    ],
  });
}
