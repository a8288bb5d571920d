import type { Schema } from "../session/client";
import { crossrangeWords, downrangeWords, fixed } from "../words/format";
import { ellipsePath } from "./ellipse";
import classes from "./LandingPlot.module.css";
import { niceStep } from "./scale";

type Point = { downrange_m: number; crossrange_m: number };
type Props = {
  ellipse: Schema["LandingEllipse"] | null;
  predicted: Point | null;
  measured: Point | null;
  /** Half the height of the picture is at least this, m. */
  least_m?: number;
  /** A click on the plot, in throw coordinates about the target. */
  onPick?: (point: Point) => void;
};

const WIDTH = 320;
const HEIGHT = 150;

/**
 * The landing around the target in throw coordinates, seen from above: downrange to the right,
 * left of the line up, equal axes, target at the cross of the zero lines.
 */
export function LandingPlot({ ellipse, predicted, measured, least_m = 0.04, onPick }: Props) {
  // A point that is being picked must not change the scale under the pointer.
  const half_m = halfHeight(ellipse, onPick ? [predicted] : [predicted, measured], least_m);
  const scale = HEIGHT / 2 / half_m;
  const step_m = niceStep(half_m);
  const x = (m: number) => WIDTH / 2 + m * scale;
  const y = (m: number) => HEIGHT / 2 - m * scale;
  // The names of the ellipses stand where the mark of the impact does not.
  const side =
    ellipse && measured && measured.downrange_m > ellipse.mean_downrange_error_m ? -1 : 1;
  const pick = (event: React.MouseEvent<SVGSVGElement>) => {
    const box = event.currentTarget.getBoundingClientRect();
    const toView = WIDTH / box.width;
    onPick?.({
      downrange_m: ((event.clientX - box.left) * toView - WIDTH / 2) / scale,
      crossrange_m: (HEIGHT / 2 - (event.clientY - box.top) * toView) / scale,
    });
  };
  return (
    // biome-ignore lint/a11y/useKeyWithClickEvents: the fields beside it take the same point by keys
    <svg
      className={classes.plot}
      data-pick={onPick !== undefined || undefined}
      onClick={onPick && pick}
      viewBox={`0 0 ${WIDTH} ${HEIGHT}`}
      role="img"
      aria-label={label(predicted, measured)}
    >
      <path d={`M0 ${y(0)}H${WIDTH}M${x(0)} 0V${HEIGHT}`} className={classes.zero} />
      {ellipse && (
        <>
          <path d={ellipsePath(ellipse, 2, x, y)} className={classes.two} />
          <path d={ellipsePath(ellipse, 1, x, y)} className={classes.one} />
          {[1, 2].map((sigma) => (
            <text
              key={sigma}
              x={
                x(ellipse.mean_downrange_error_m + side * sigma * ellipse.sd_downrange_m) + 3 * side
              }
              y={y(ellipse.mean_crossrange_error_m) + 12}
              textAnchor={side > 0 ? "start" : "end"}
              className={classes.text}
            >
              {sigma}σ
            </text>
          ))}
        </>
      )}
      {predicted && (
        <circle
          cx={x(predicted.downrange_m)}
          cy={y(predicted.crossrange_m)}
          r="3.5"
          className={classes.predicted}
        />
      )}
      {measured && (
        <path
          d={`M${x(measured.downrange_m)} ${y(measured.crossrange_m)}m-6 -6l12 12m0 -12l-12 12`}
          className={classes.measured}
        />
      )}
      <path
        d={`M8 ${HEIGHT - 8}h${step_m * scale}m0 -4v8m${-step_m * scale} 0v-8`}
        className={classes.bar}
      />
      <text x={14 + step_m * scale} y={HEIGHT - 4} className={classes.text}>
        {fixed(step_m, step_m < 0.1 ? 2 : 1)} m
      </text>
      <text x={WIDTH - 6} y={y(0) - 5} textAnchor="end" className={classes.text}>
        long
      </text>
      <text x={x(0) + 5} y={12} className={classes.text}>
        left
      </text>
    </svg>
  );
}

function halfHeight(ellipse: Props["ellipse"], points: (Point | null)[], least_m: number): number {
  const reach = points.map((p) =>
    p ? Math.max(Math.abs(p.crossrange_m), Math.abs(p.downrange_m) / 2) : 0,
  );
  if (ellipse) {
    reach.push(Math.abs(ellipse.mean_crossrange_error_m) + 2 * ellipse.sd_crossrange_m);
    reach.push((Math.abs(ellipse.mean_downrange_error_m) + 2 * ellipse.sd_downrange_m) / 2);
  }
  return Math.max(least_m, ...reach) * 1.25;
}

function label(predicted: Point | null, measured: Point | null): string {
  const parts = ["Landing around the target."];
  if (predicted)
    parts.push(
      `Predicted ${downrangeWords(predicted.downrange_m)}, ${crossrangeWords(predicted.crossrange_m)}.`,
    );
  if (measured)
    parts.push(
      `Measured ${downrangeWords(measured.downrange_m)}, ${crossrangeWords(measured.crossrange_m)}.`,
    );
  return parts.join(" ");
}
