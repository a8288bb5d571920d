import classes from "./IntervalBar.module.css";

type Props = {
  value_m: number;
  ci90_m: readonly [number, number];
  /** Half of the bar, m: the same for the whole chain. */
  limit_m: number;
  words: string;
};

const HALF = 80;

/** A mean and its 90 % interval about zero. */
export function IntervalBar({ value_m, ci90_m, limit_m, words }: Props) {
  const at = (value: number) =>
    HALF + (limit_m > 0 ? Math.max(-1, Math.min(1, value / limit_m)) : 0) * (HALF - 4);
  return (
    <svg
      className={classes.bar}
      viewBox={`0 0 ${2 * HALF} 14`}
      role="img"
      aria-label={words}
      preserveAspectRatio="none"
    >
      <title>{words}</title>
      <path d={`M${HALF} 0v14`} className={classes.zero} />
      <path d={`M${at(ci90_m[0])} 7H${at(ci90_m[1])}`} className={classes.interval} />
      <path d={`M${at(value_m)} 1v12`} className={classes.mark} />
    </svg>
  );
}
