import { useComputedColorScheme } from "@mantine/core";
import { useEffect, useRef } from "react";
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { ChartFrame } from "./ChartFrame";
import { seriesCsv, seriesSvg } from "./seriesExport";
import { type Band, bandPlugin, type Line, plotOptions } from "./seriesPlot";
import classes from "./TimeSeries.module.css";
import { useSize } from "./useSize";

type Props = {
  title: string;
  unit: string;
  t_s: readonly number[];
  lines: readonly Line[];
  bands: readonly Band[];
  /** Moment of the replay, s. */
  at_s: number;
  onSeek: (at_s: number) => void;
};

/** Lines over time with the phases as bands; hover reads values, a click moves the replay. */
export function TimeSeries({ title, unit, t_s, lines, bands, at_s, onSeek }: Props) {
  const { ref, width, height } = useSize<HTMLDivElement>();
  const scheme = useComputedColorScheme("dark");
  const plot = useRef<uPlot | null>(null);
  const head = useRef<HTMLDivElement>(null);
  const seek = useRef(onSeek);
  seek.current = onSeek;
  const now = useRef(at_s);
  now.current = at_s;

  // biome-ignore lint/correctness/useExhaustiveDependencies: a new scheme needs new canvas colours
  useEffect(() => {
    const box = ref.current;
    if (!box || width < 40 || height < 40) return;
    const data = [[...t_s], ...lines.map((line) => [...line.values])] as uPlot.AlignedData;
    const created = new uPlot(
      { ...plotOptions(lines, unit, width, height), plugins: [bandPlugin(bands)] },
      data,
      box,
    );
    const onClick = () => {
      const time_s = created.posToVal(created.cursor.left ?? -1, "x");
      if (Number.isFinite(time_s)) seek.current(Math.max(0, time_s));
    };
    created.over.addEventListener("click", onClick);
    plot.current = created;
    placeHead(created, head.current, now.current);
    return () => {
      plot.current = null;
      created.destroy();
    };
  }, [ref, width, height, scheme, t_s, lines, bands, unit]);

  useEffect(() => {
    if (plot.current) placeHead(plot.current, head.current, at_s);
  }, [at_s]);

  return (
    <ChartFrame
      title={title}
      note={unit}
      getSvg={() => seriesSvg(title, unit, t_s, lines, bands)}
      toCsv={() => seriesCsv(t_s, lines)}
    >
      <div ref={ref} className={classes.plot}>
        <div ref={head} className={classes.head} aria-hidden="true" />
      </div>
    </ChartFrame>
  );
}

/** The line at the replay's moment; moved without drawing the chart again. */
function placeHead(plot: uPlot, head: HTMLDivElement | null, at_s: number): void {
  if (!head) return;
  const left = plot.valToPos(at_s, "x") + plot.over.offsetLeft;
  head.style.transform = `translateX(${left}px)`;
  head.style.top = `${plot.over.offsetTop}px`;
  head.style.height = `${plot.over.offsetHeight}px`;
}
