import * as Plot from "@observablehq/plot";
import { useCallback } from "react";
import { toCsv } from "../charts/export";
import { PlotFigure } from "../charts/PlotFigure";
import { signed } from "../words/format";
import type { Surface } from "./job";
import type { Rectangle } from "./rectangle";
import { type SectionPoint, section } from "./surface";

type Props = { surface: Surface; place: Rectangle; direction: "along" | "across" };

const TITLES = { along: "Section along", across: "Section across" };
const AXES = { along: "From the middle, m (+ front)", across: "From the middle, m (+ left)" };

/** The ground through the middle of the goal: at the start, now, and as it shall be. */
export function SectionChart({ surface, place, direction }: Props) {
  const points = section(surface, place, direction);
  const key = JSON.stringify([surface.version_count, place, direction]);
  // biome-ignore lint/correctness/useExhaustiveDependencies: the points follow from the key
  const draw = useCallback(
    (width: number, height: number) => drawn(points, direction, width, height),
    [key, direction],
  );
  return (
    <PlotFigure
      title={TITLES[direction]}
      note="wanted dashed"
      draw={draw}
      toCsv={() =>
        toCsv(
          ["at_m", "start_m", "now_m", "wanted_m"],
          points.map((point) => [point.at_m, point.start_m, point.now_m, point.wanted_m]),
        )
      }
    />
  );
}

function drawn(
  points: readonly SectionPoint[],
  direction: Props["direction"],
  width: number,
  height: number,
) {
  return Plot.plot({
    width,
    height,
    marginTop: 24,
    marginRight: 14,
    marginBottom: 34,
    marginLeft: 44,
    style: { background: "transparent", fontSize: "11px", overflow: "visible" },
    x: { label: AXES[direction], labelAnchor: "center", labelArrow: "none", tickSpacing: 50 },
    y: { label: "Height, m", labelArrow: "none", nice: true, grid: true, ticks: 4 },
    marks: [
      Plot.line(points, {
        x: "at_m",
        y: "start_m",
        stroke: "var(--line-strong)",
        strokeWidth: 1.4,
      }),
      Plot.line(points, {
        x: "at_m",
        y: "wanted_m",
        stroke: "var(--accent)",
        strokeDasharray: "6 4",
        strokeWidth: 1.6,
      }),
      Plot.line(points, { x: "at_m", y: "now_m", stroke: "var(--ink)", strokeWidth: 2 }),
      Plot.tip(
        points,
        Plot.pointerX({
          x: "at_m",
          y: "now_m",
          fill: "var(--panel)",
          stroke: "var(--line-strong)",
          title: (point: SectionPoint) =>
            `start ${signed(point.start_m)} m\nnow ${signed(point.now_m)} m` +
            (point.wanted_m === null ? "" : `\nwanted ${signed(point.wanted_m)} m`),
        }),
      ),
    ],
  });
}
