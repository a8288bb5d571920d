import { useComputedColorScheme } from "@mantine/core";
import { useMemo, useRef, useState } from "react";
import { ChartFrame } from "../charts/ChartFrame";
import { toCsv } from "../charts/export";
import { niceStep } from "../charts/scale";
import { useSize } from "../charts/useSize";
import { fixed, signed } from "../words/format";
import { goalPlace, heapOf } from "./goal";
import type { Job, Surface } from "./job";
import { cornersOf, type Point, type Rectangle } from "./rectangle";
import classes from "./SurfaceMap.module.css";
import {
  cellOf,
  contourLevels,
  contourSegments,
  heightAt,
  heightRange,
  type Window,
  windowOf,
} from "./surface";
import { tonePicture } from "./tone";

/** Drawn outside of what is filled. */
const WALL_M = 0.12;
/** Landings that are numbered; older ones are dots. */
const NUMBERED_COUNT = 6;
const EDGE = { left: 34, right: 16, top: 8, bottom: 24 };

type Props = {
  job: Job;
  surface: Surface;
  /** The proposal that the next click places. */
  moving: number | null;
  onPoint: (point: Point) => void;
};

/** The surface from above: heights as tones with contour lines, the goal, where loads fell and will fall. */
export function SurfaceMap({ job, surface, moving, onPoint }: Props) {
  const { ref, width, height } = useSize<HTMLDivElement>();
  const svg = useRef<SVGSVGElement>(null);
  const [read, setRead] = useState<Point | null>(null);
  const place = goalPlace(job.file);
  const corners = place ? cornersOf(place) : [];
  const heap = heapOf(job.file);
  const heapCorners = heap ? cornersOf(heap) : [];
  const loads = job.loads.filter((load) => !load.is_withdrawn);
  const points: Point[] = [
    ...corners,
    ...heapCorners,
    ...job.next.map(({ x_m, y_m }) => [x_m, y_m] as const),
    ...loads.map(({ x_m, y_m }) => [x_m, y_m] as const),
  ];
  const window = windowOf(surface, points);
  const view = viewOf(window, width, height);
  const pointAt = (event: React.MouseEvent<SVGSVGElement>): Point => {
    const box = event.currentTarget.getBoundingClientRect();
    return [round(view.toX(event.clientX - box.left)), round(view.toY(event.clientY - box.top))];
  };
  const isMoving = moving !== null;
  return (
    <ChartFrame
      title="Surface from above"
      note={noteOf(surface, read, isMoving ? moving : null)}
      getSvg={() => svg.current}
      toCsv={() => heightsCsv(surface)}
    >
      <div ref={ref} className={classes.box}>
        {width > 80 && height > 80 && (
          // biome-ignore lint/a11y/useKeyWithClickEvents: the fields of the proposal take the same point by keys
          <svg
            ref={svg}
            width={width}
            height={height}
            className={classes.map}
            data-testid="surface-map"
            data-version={surface.version_count}
            data-move={isMoving || undefined}
            role="img"
            aria-label={labelOf(job, surface)}
            onPointerMove={(event) => setRead(pointAt(event))}
            onPointerLeave={() => setRead(null)}
            onClick={isMoving ? (event) => onPoint(pointAt(event)) : undefined}
          >
            <clipPath id="surface-window">
              <rect {...view.frame} />
            </clipPath>
            <Ticks view={view} window={window} />
            <g clipPath="url(#surface-window)">
              <Ground surface={surface} window={window} view={view} />
              <line
                x1={view.x(0)}
                y1={view.y(0)}
                x2={view.x(place?.x_m ?? 0)}
                y2={view.y(place?.y_m ?? 0)}
                className={classes.bearing}
              />
              {surface.containers.map((item) => (
                <polygon
                  key={item.name}
                  points={view.polygon(cornersOf(withWalls(item)))}
                  className={classes.container}
                />
              ))}
              {corners.length > 0 && (
                <polygon points={view.polygon(corners)} className={classes.wanted} />
              )}
              {heap && (
                <>
                  <polygon points={view.polygon(heapCorners)} className={classes.heap} />
                  <text
                    x={view.x(heap.x_m)}
                    y={view.y(Math.max(...heapCorners.map(([, y]) => y))) - 6}
                    className={classes.heapName}
                  >
                    heap
                  </text>
                </>
              )}
              {loads.map((load, index) => {
                const isRecent = index >= loads.length - NUMBERED_COUNT;
                return (
                  <g key={load.load_count} transform={view.at([load.x_m, load.y_m])}>
                    <circle r={isRecent ? 8.5 : 3} className={classes.landing} />
                    {isRecent && (
                      <text y="3.5" className={classes.number}>
                        {load.load_count}
                      </text>
                    )}
                  </g>
                );
              })}
              {job.next.map((one) => (
                <g key={one.proposal_count} transform={view.at([one.x_m, one.y_m])}>
                  <path d="M0 -13L13 0L0 13L-13 0Z" className={classes.next} />
                  <text y="4" className={classes.nextNumber}>
                    {one.proposal_count}
                  </text>
                </g>
              ))}
            </g>
            <rect {...view.frame} className={classes.frame} />
          </svg>
        )}
      </div>
    </ChartFrame>
  );
}

type GroundProps = { surface: Surface; window: Window; view: View };

/** Tones and contour lines; drawn anew only for another surface or size. */
function Ground({ surface, window, view }: GroundProps) {
  const scheme = useComputedColorScheme("dark");
  const [low, high] = heightRange(surface, surface.height_m, window);
  const picture = useMemo(
    () => tonePicture(surface.height_m, low, high, scheme === "dark"),
    [surface, low, high, scheme],
  );
  const lines = useMemo(
    () =>
      contourLevels(low, high).levels.map((level) => ({
        level,
        segments: contourSegments(surface, surface.height_m, level),
      })),
    [surface, low, high],
  );
  const half = cellOf(surface) / 2;
  const [x0, x1] = [surface.x_m[0] ?? 0, surface.x_m.at(-1) ?? 0];
  const [y0, y1] = [surface.y_m[0] ?? 0, surface.y_m.at(-1) ?? 0];
  return (
    <>
      {picture && (
        <image
          href={picture}
          x={view.x(x0 - half)}
          y={view.y(y1 + half)}
          width={(x1 - x0 + 2 * half) * view.scale}
          height={(y1 - y0 + 2 * half) * view.scale}
          preserveAspectRatio="none"
        />
      )}
      {lines.map(({ level, segments }) => (
        <path
          key={level}
          className={classes.contour}
          data-zero={level === 0 || undefined}
          d={segments
            .map(
              ([ax, ay, bx, by]) =>
                `M${pixel(view.x(ax))} ${pixel(view.y(ay))}L${pixel(view.x(bx))} ${pixel(view.y(by))}`,
            )
            .join("")}
        />
      ))}
    </>
  );
}

function Ticks({ view, window }: { view: View; window: Window }) {
  const step = niceStep(Math.max(0.1, 70 / view.scale));
  const along = (from: number, to: number) => {
    const first = Math.ceil(from / step);
    const count = Math.max(0, Math.floor(to / step) - first + 1);
    return Array.from({ length: count }, (_, number) => round((first + number) * step));
  };
  const { frame } = view;
  return (
    <g className={classes.ticks}>
      {along(window.x[0], window.x[1]).map((x) => (
        <text key={x} x={view.x(x)} y={frame.y + frame.height + 15} textAnchor="middle">
          {fixed(x, step < 1 ? 1 : 0)}
        </text>
      ))}
      {along(window.y[0], window.y[1]).map((y) => (
        <text key={y} x={frame.x - 5} y={view.y(y) + 4} textAnchor="end">
          {fixed(y, step < 1 ? 1 : 0)}
        </text>
      ))}
    </g>
  );
}

const withWalls = (item: Rectangle): Rectangle => ({
  ...item,
  length_m: item.length_m + 2 * WALL_M,
  width_m: item.width_m + 2 * WALL_M,
});

type View = ReturnType<typeof viewOf>;

/** Equal axes: x to the right, left of the machine up. */
function viewOf(window: Window, width: number, height: number) {
  const [dx, dy] = [window.x[1] - window.x[0], window.y[1] - window.y[0]];
  const room = { x: width - EDGE.left - EDGE.right, y: height - EDGE.top - EDGE.bottom };
  const scale = Math.max(1, Math.min(room.x / dx, room.y / dy));
  const left = EDGE.left + (room.x - dx * scale) / 2;
  const top = EDGE.top + (room.y - dy * scale) / 2;
  const x = (m: number) => left + (m - window.x[0]) * scale;
  const y = (m: number) => top + (window.y[1] - m) * scale;
  return {
    scale,
    x,
    y,
    toX: (pixels: number) => window.x[0] + (pixels - left) / scale,
    toY: (pixels: number) => window.y[1] - (pixels - top) / scale,
    at: ([px, py]: Point) => `translate(${pixel(x(px))} ${pixel(y(py))})`,
    polygon: (points: readonly Point[]) =>
      points.map(([px, py]) => `${pixel(x(px))},${pixel(y(py))}`).join(" "),
    frame: { x: left, y: top, width: Math.max(0, dx * scale), height: Math.max(0, dy * scale) },
  };
}

const round = (m: number) => Number(m.toFixed(2));
const pixel = (value: number) => Number(value.toFixed(1));

function noteOf(surface: Surface, read: Point | null, moving: number | null): string {
  if (read) {
    const height = heightAt(surface, surface.height_m, read);
    if (height !== null)
      return `x ${fixed(read[0])} m, y ${fixed(read[1])} m: ${signed(height)} m high`;
  }
  if (moving !== null) return `Click where load ${moving} shall go.`;
  const [low, high] = heightRange(surface, surface.height_m, windowOf(surface, []));
  return `x forward, y left, m; a line every ${fixed(contourLevels(low, high).step_m)} m`;
}

function labelOf(job: Job, surface: Surface): string {
  const [low, high] = heightRange(surface, surface.height_m, windowOf(surface, []));
  const landed = job.loads.filter((load) => !load.is_withdrawn).length;
  return (
    `Surface from above, ${signed(low)} to ${signed(high)} m high, with ${landed} landings ` +
    `and ${job.next.length} proposals.`
  );
}

function heightsCsv(surface: Surface): string {
  const rows = surface.y_m.flatMap((y, row) =>
    surface.x_m.map((x, column) => [
      x,
      y,
      surface.start_m[row]?.[column],
      surface.height_m[row]?.[column],
      surface.wanted_m[row]?.[column],
    ]),
  );
  return toCsv(["x_m", "y_m", "start_m", "height_m", "wanted_m"], rows);
}
