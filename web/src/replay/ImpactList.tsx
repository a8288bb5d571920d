import type { Schema } from "../session/client";
import { crossrangeWords, downrangeWords, heightWords, metres } from "../words/format";
import { localStamp } from "../words/time";
import classes from "./Facts.module.css";

type Impact = Schema["ImpactView"];

/** Every record of where the load came down; the one that counts is named. */
export function ImpactList({ impacts }: { impacts: readonly Impact[] }) {
  if (impacts.length === 0) return <p className={classes.note}>No impact recorded yet.</p>;
  return (
    <ul className={classes.list}>
      {impacts.map((impact) => (
        <li key={impact.impact_id} data-current={impact.is_current || undefined}>
          <span>
            {downrangeWords(impact.downrange_error_m)}, {crossrangeWords(impact.crossrange_error_m)}
            {heightWords(impact.z_m)}
            {impact.is_current && <strong> counts</strong>}
          </span>
          <span className={classes.note}>
            {impact.source} by {impact.recorded_by}, {localStamp(impact.created_utc)}
            {impact.sd_m !== null && `, sd ${metres(impact.sd_m)}`}
            {impact.note && `: ${impact.note}`}
          </span>
        </li>
      ))}
    </ul>
  );
}
