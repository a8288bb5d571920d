import plot from "../charts/LandingPlot.module.css";
import { niceStep } from "../charts/scale";
import { fixed } from "../words/format";
import classes from "./Shadow.module.css";
import { type Miss, measuredOf, missOf, type Shadow } from "./shadow";

const WIDTH = 420;
const HEIGHT = 220;

/**
 * Misses about the target, seen from above, in throw coordinates with equal axes: the version (dot) joined
 * with the version that flew (ring), both in the twin, and what was measured (cross).
 */
export function ShadowPlot({ found }: { found: Shadow }) {
  const rows = found.throws.map((one) => ({
    id: one.throw_id,
    own: missOf(one.candidate),
    flown: missOf(one.flown),
    measured: measuredOf(one),
  }));
  const points = rows
    .flatMap((row) => [row.own, row.flown, row.measured])
    .filter((point) => point !== null);
  const reach = points.map((p) =>
    Math.max(Math.abs(p.crossrange_m), Math.abs(p.downrange_m) / 1.9),
  );
  const half_m = Math.max(0.05, ...reach) * 1.2;
  const scale = HEIGHT / 2 / half_m;
  const step_m = niceStep(half_m);
  const x = (p: Miss) => WIDTH / 2 + p.downrange_m * scale;
  const y = (p: Miss) => HEIGHT / 2 - p.crossrange_m * scale;
  return (
    <figure className={classes.figure}>
      <svg
        className={plot.plot}
        viewBox={`0 0 ${WIDTH} ${HEIGHT}`}
        role="img"
        aria-label={`Misses of ${rows.length} throws about the target; the table has the numbers.`}
      >
        <path d={`M0 ${HEIGHT / 2}H${WIDTH}M${WIDTH / 2} 0V${HEIGHT}`} className={plot.zero} />
        {rows.map(({ id, own, flown, measured }) => (
          <g key={id}>
            {own && flown && (
              <path d={`M${x(flown)} ${y(flown)}L${x(own)} ${y(own)}`} className={classes.join} />
            )}
            {measured && (
              <path
                d={`M${x(measured)} ${y(measured)}m-4 -4l8 8m0 -8l-8 8`}
                className={plot.measured}
              />
            )}
            {flown && <circle cx={x(flown)} cy={y(flown)} r="4" className={classes.flown} />}
            {own && <circle cx={x(own)} cy={y(own)} r="3.5" className={plot.predicted} />}
          </g>
        ))}
        <path
          d={`M8 ${HEIGHT - 8}h${step_m * scale}m0 -4v8m${-step_m * scale} 0v-8`}
          className={plot.bar}
        />
        <text x={14 + step_m * scale} y={HEIGHT - 4} className={plot.text}>
          {fixed(step_m, step_m < 0.1 ? 2 : 1)} m
        </text>
        <text x={WIDTH - 6} y={HEIGHT / 2 - 5} textAnchor="end" className={plot.text}>
          long
        </text>
        <text x={WIDTH / 2 + 5} y={12} className={plot.text}>
          left
        </text>
      </svg>
      <figcaption className={classes.caption}>
        ● {found.policy_id} in the twin, ○ what flew in the twin, × measured
      </figcaption>
    </figure>
  );
}
