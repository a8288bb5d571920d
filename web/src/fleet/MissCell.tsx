import { count, fixed, metres } from "../words/format";
import { Shortened } from "../words/Shortened";
import classes from "./Fleet.module.css";
import { isWorse } from "./rows";
import type { MissFigures, ModeSummary } from "./useFleet";

/** Mean miss of the newest throws in a mode beside that of the first ones; both in full at a press. */
export function MissCell({ mode }: { mode: ModeSummary }) {
  const { recent, baseline } = mode;
  if (!recent) return <span className={classes.dim}>no measured throw</span>;
  const worse = isWorse(mode);
  return (
    <span>
      <strong data-look={worse || undefined} className={classes.figure}>
        <Shortened
          short={metres(recent.mean_miss_m)}
          whole={wholeOf(recent, baseline)}
          name={`Mean miss in ${mode.mode.toUpperCase()}`}
        />
      </strong>{" "}
      <span className={classes.dim}>
        {baseline
          ? `was ${metres(baseline.mean_miss_m)}`
          : `in ${count(recent.throw_count, "throw")}`}
        {worse && ", more than chance"}
      </span>
    </span>
  );
}

function wholeOf(recent: MissFigures, baseline: MissFigures | null): string {
  const now = `Newest: ${figureWords(recent)}`;
  return baseline ? `${now}.\nFirst: ${figureWords(baseline)}.` : now;
}

function figureWords(figures: MissFigures): string {
  return (
    `mean miss ${metres(figures.mean_miss_m)} of ${count(figures.throw_count, "throw")}, ` +
    `sd ${fixed(figures.sd_downrange_m)} m along, ${fixed(figures.sd_crossrange_m)} m across`
  );
}
