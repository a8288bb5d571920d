import { fixed, percent } from "../words/format";
import classes from "./ShrinkBars.module.css";
import type { Diagnosis } from "./words";

/** How far the gap shrinks on throws that did not choose the cause. */
export function ShrinkBars({ found }: { found: Diagnosis }) {
  const { shrink } = found;
  if (!shrink) return null;
  const unit =
    typeof found.evidence.residual_unit === "string" ? found.evidence.residual_unit : "m";
  const largest = Math.max(shrink.before_m, shrink.after_m, 1e-12);
  const rows = [
    { name: "twin before", value: shrink.before_m, kind: "before" },
    { name: "twin after", value: shrink.after_m, kind: "after" },
  ];
  return (
    <>
      <p className={classes.words}>
        Removes {percent(shrink.ratio)} of the removable gap on {shrink.held_out_throws} held-out
        throws, 90 % interval {percent(shrink.ci90[0])} to {percent(shrink.ci90[1])}.
        {typeof shrink.predicted_ratio === "number" &&
          ` Predicted before it was added: ${percent(shrink.predicted_ratio)}.`}{" "}
        {percent(shrink.removable_ratio)} of the gap is removable, the rest is noise and jitter.
      </p>
      <dl className={classes.bars}>
        {rows.map((row) => (
          <div key={row.name} className={classes.row}>
            <dt>{row.name}</dt>
            <dd>
              {fixed(row.value, 3)} {unit}
            </dd>
            <span className={classes.track} aria-hidden>
              <span data-kind={row.kind} style={{ width: `${(100 * row.value) / largest}%` }} />
            </span>
          </div>
        ))}
      </dl>
    </>
  );
}
