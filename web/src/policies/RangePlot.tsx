import { symmetricLimit } from "../charts/scale";
import { useSize } from "../charts/useSize";
import { fixed } from "../words/format";
import type { EvaluationRow } from "./evaluation";
import classes from "./RangePlot.module.css";

const HEIGHT = 180;
const LEFT = 44;
/** Half of the last range in words. */
const RIGHT = 22;
const BOTTOM = 26;
const TOP = 8;
/** Crossrange stands beside downrange, so that neither hides the other. */
const ASIDE = 5;
const MOST_LABELS = 10;

/** Mean error and one standard deviation at each target range, along and across; ground targets. */
export function RangePlot({ rows, where }: { rows: readonly EvaluationRow[]; where: string }) {
  const { ref, width } = useSize<HTMLElement>();
  const ground = rows.filter((row) => row.height_m === 0);
  if (ground.length < 2) return null;
  const ranges = ground.map((row) => row.range_m);
  const first = Math.min(...ranges);
  const last = Math.max(...ranges);
  const limit = symmetricLimit(
    ground.flatMap((row) => [
      Math.abs(row.mean_downrange_error_m ?? 0) + (row.sd_downrange_m ?? 0),
      Math.abs(row.mean_crossrange_error_m ?? 0) + (row.sd_crossrange_m ?? 0),
    ]),
    0.1,
  );
  const x = (range: number) =>
    LEFT + 14 + ((width - LEFT - 14 - RIGHT) * (range - first)) / Math.max(last - first, 1e-9);
  const y = (error: number) => TOP + ((HEIGHT - TOP - BOTTOM) * (limit - error)) / (2 * limit);
  const tick = limit > 0.25 ? 0.2 : 0.1;
  const words = `Mean error and standard deviation by target range, ${where}`;
  const every = Math.ceil(ground.length / MOST_LABELS);
  return (
    <figure className={classes.plot} ref={ref}>
      <svg width={width} height={HEIGHT} role="img" aria-label={words}>
        <title>{words}</title>
        {[-tick, 0, tick].map((value) => (
          <g key={value}>
            <path
              className={value === 0 ? classes.zero : classes.grid}
              d={`M${LEFT} ${y(value)}H${width}`}
            />
            <text x={LEFT - 6} y={y(value) + 4} textAnchor="end">
              {fixed(value, 1)}
            </text>
          </g>
        ))}
        {ground.map((row, index) => (
          <g key={row.range_m}>
            <Bar
              at={x(row.range_m) - ASIDE}
              mean={row.mean_downrange_error_m}
              sd={row.sd_downrange_m}
              y={y}
              css={classes.along ?? ""}
            />
            <Bar
              at={x(row.range_m) + ASIDE}
              mean={row.mean_crossrange_error_m}
              sd={row.sd_crossrange_m}
              y={y}
              css={classes.across ?? ""}
            />
            {index % every === 0 && (
              <text x={x(row.range_m)} y={HEIGHT - 8} textAnchor="middle">
                {fixed(row.range_m, Number.isInteger(row.range_m * 2) ? 1 : 2)}
              </text>
            )}
          </g>
        ))}
      </svg>
      <figcaption>
        <span className={classes.alongKey}>along</span>,{" "}
        <span className={classes.acrossKey}>across</span>: mean and one standard deviation, m, over
        the target range, m
      </figcaption>
    </figure>
  );
}

type BarProps = {
  at: number;
  mean: number | null;
  sd: number | null;
  y: (error: number) => number;
  css: string;
};

function Bar({ at, mean, sd, y, css }: BarProps) {
  if (mean === null) return null;
  return (
    <g className={css}>
      {sd !== null && <path d={`M${at} ${y(mean + sd)}V${y(mean - sd)}`} />}
      <circle cx={at} cy={y(mean)} r={3} />
    </g>
  );
}
