import { fixed } from "../words/format";
import classes from "./MissBar.module.css";

type Props = {
  predicted_m: number | null;
  measured_m: number | null;
  /** Half of the bar, m: the same for all rows of the page. */
  limit_m: number;
  words: string;
};

const HALF = 26;

/** Predicted (tick) and measured (bar) miss about zero; longer than the scale ends in an arrow. */
export function MissBar({ predicted_m, measured_m, limit_m, words }: Props) {
  const at = (value: number) => HALF + Math.max(-1, Math.min(1, value / limit_m)) * (HALF - 4);
  return (
    <svg
      className={classes.bar}
      width={HALF * 2}
      height="14"
      viewBox={`0 0 ${HALF * 2} 14`}
      role="img"
      aria-label={`${words}, predicted ${fixed(predicted_m)} m`}
    >
      <path d={`M${HALF} 0v14`} className={classes.zero} />
      {measured_m !== null && (
        <rect
          x={Math.min(HALF, at(measured_m))}
          y="3"
          width={Math.max(1.5, Math.abs(at(measured_m) - HALF))}
          height="8"
          className={classes.measured}
        />
      )}
      {measured_m !== null && Math.abs(measured_m) > limit_m && (
        <path
          d={measured_m > 0 ? `M${HALF * 2 - 5} 3l4 4-4 4` : "M5 3 1 7l4 4"}
          className={classes.over}
        />
      )}
      {predicted_m !== null && (
        <path d={`M${at(predicted_m)} 1v12`} className={classes.predicted} />
      )}
    </svg>
  );
}
