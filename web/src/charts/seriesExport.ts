/** Time series as SVG (drawn anew by Observable Plot) and as CSV. */

import * as Plot from "@observablehq/plot";
import { toCsv } from "./export";
import { type Band, type Line, token } from "./seriesPlot";

const WIDTH = 960;
const HEIGHT = 320;

type Sample = { t_s: number; value: number | null; label: string };

export function seriesCsv(t_s: readonly number[], lines: readonly Line[]): string {
  return toCsv(
    ["t_s", ...lines.map((line) => line.label)],
    t_s.map((t, index) => [t, ...lines.map((line) => line.values[index] ?? null)]),
  );
}

/** A drawing of its own: what a canvas shows cannot be saved as vectors. */
export function seriesSvg(
  title: string,
  unit: string,
  t_s: readonly number[],
  lines: readonly Line[],
  bands: readonly Band[],
): SVGSVGElement | null {
  const samples = lines.flatMap((line) =>
    t_s.map(
      (t, index): Sample => ({ t_s: t, value: line.values[index] ?? null, label: line.label }),
    ),
  );
  const figure = Plot.plot({
    width: WIDTH,
    height: HEIGHT,
    style: { background: token("--panel"), color: token("--ink"), fontFamily: "sans-serif" },
    x: { label: "t, s" },
    y: { label: `${title}, ${unit}`, grid: true },
    marks: [
      Plot.rectX(bands, {
        x1: "start_s",
        x2: "end_s",
        fill: token("--panel-raised"),
        fillOpacity: 0.6,
      }),
      Plot.text(bands, {
        x: (band: Band) => (band.start_s + band.end_s) / 2,
        text: "name",
        frameAnchor: "top",
        fill: token("--ink-dim"),
      }),
      Plot.ruleY([0], { stroke: token("--line-strong") }),
      lines.map((line) =>
        Plot.line(
          samples.filter((sample) => sample.label === line.label),
          {
            x: "t_s",
            y: "value",
            stroke: token(line.colour),
            strokeDasharray: line.isDashed ? "5 4" : undefined,
          },
        ),
      ),
    ],
  });
  const svg = figure instanceof SVGSVGElement ? figure : figure.querySelector("svg");
  if (svg) attachForStyles(svg);
  return svg;
}

/** Computed styles exist only in the document; the drawing stays there unseen for one turn. */
function attachForStyles(svg: SVGSVGElement): void {
  svg.style.position = "fixed";
  svg.style.left = "-10000px";
  document.body.append(svg);
  setTimeout(() => svg.remove(), 5000);
}
