import { Link } from "@tanstack/react-router";
import { bearingWords, metres } from "../words/format";
import { localStamp, zoneName } from "../words/time";
import type { Job } from "./job";
import classes from "./Work.module.css";
import { cubic, landedWords } from "./words";

/** Every load of the job, newest first; those taken back stay in it. */
export function LoadTable({ job }: { job: Job }) {
  if (job.loads.length === 0) {
    return (
      <p className={classes.note}>
        No load yet. A throw at one of the next loads is recorded here by itself.
      </p>
    );
  }
  return (
    <section
      className={classes.scroll}
      aria-label="Loads"
      // biome-ignore lint/a11y/noNoninteractiveTabindex: what scrolls sideways is reached by keys
      tabIndex={0}
    >
      <table className={classes.table}>
        <thead>
          <tr>
            <th scope="col">Load</th>
            <th scope="col">Time, {zoneName(new Date())}</th>
            <th scope="col">Landed</th>
            <th scope="col">Volume</th>
            <th scope="col">Impact</th>
            <th scope="col">By</th>
            <th scope="col">Throw</th>
          </tr>
        </thead>
        <tbody>
          {job.loads.toReversed().map((load) => (
            <tr
              key={load.load_count}
              data-load={load.load_count}
              data-withdrawn={load.is_withdrawn || undefined}
            >
              <th scope="row">{load.load_count}</th>
              <td>{localStamp(load.at_utc)}</td>
              <td>
                {metres(Math.hypot(load.x_m, load.y_m))},{" "}
                {bearingWords(Math.atan2(load.y_m, load.x_m))}
              </td>
              <td>{cubic(load.volume_m3)}</td>
              <td>{load.is_withdrawn ? "taken back" : landedWords(load)}</td>
              <td>{load.recorded_by}</td>
              <td>
                {load.throw_id ? (
                  <Link to="/throws/$throwId" params={{ throwId: load.throw_id }}>
                    Open
                  </Link>
                ) : (
                  "–"
                )}
              </td>
            </tr>
          ))}
        </tbody>
      </table>
    </section>
  );
}
