import { useEffect, useRef } from "react";
import { ChartFrame } from "./ChartFrame";
import { useSize } from "./useSize";

type Figure = (SVGSVGElement | HTMLElement) & { value?: unknown };

type Props = {
  title: string;
  /** Draws the chart for a size; called again when the size or the function changes. */
  draw: (width: number, height: number) => Figure;
  /** What the pointer is on, as Plot's tip reports it; called on a click. */
  onPick?: (value: unknown) => void;
  toCsv: () => string;
  note?: React.ReactNode;
};

/** A chart of Observable Plot in React, with its title and exports. */
export function PlotFigure({ title, draw, onPick, toCsv, note }: Props) {
  const { ref, width, height } = useSize<HTMLDivElement>();
  const svg = useRef<SVGSVGElement | null>(null);
  const pick = useRef(onPick);
  pick.current = onPick;

  useEffect(() => {
    const box = ref.current;
    if (!box || width < 60 || height < 60) return;
    const figure = draw(width, height);
    svg.current = figure instanceof SVGSVGElement ? figure : figure.querySelector("svg");
    svg.current?.setAttribute("role", "img");
    // A picture has one name; those that Plot gives to its parts belong to no role.
    for (const part of svg.current?.querySelectorAll("g[aria-label]") ?? [])
      part.removeAttribute("aria-label");
    svg.current?.setAttribute("aria-label", title);
    const onClick = () => figure.value && pick.current?.(figure.value);
    figure.addEventListener("click", onClick);
    box.replaceChildren(figure);
    return () => figure.remove();
  }, [draw, width, height, ref, title]);

  return (
    <ChartFrame title={title} note={note} getSvg={() => svg.current} toCsv={toCsv}>
      <div ref={ref} style={{ width: "100%", height: "100%", overflow: "hidden" }} />
    </ChartFrame>
  );
}
