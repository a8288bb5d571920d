import { fixed, unbroken } from "../../words/format";
import { type Diagnosis, SENTENCES } from "../words";
import classes from "./ShrinkBars.module.css";

/** How far the gap shrinks on throws that did not choose the cause. */
export function ShrinkBars({ found, words }: { found: Diagnosis; words: string }) {
  const { shrink } = found;
  if (!shrink) return null;
  const unit =
    typeof found.evidence.residual_unit === "string" ? found.evidence.residual_unit : "m";
  const largest = Math.max(shrink.before_m, shrink.after_m, 1e-12);
  const rows = [
    { name: SENTENCES.twin_before, value: shrink.before_m, kind: "before" },
    { name: SENTENCES.twin_after, value: shrink.after_m, kind: "after" },
  ];
  return (
    <>
      <p className={classes.words}>{unbroken(words)}</p>
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
