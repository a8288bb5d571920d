import type { Throw } from "../session/live";
import { crossrangeWords, downrangeWords, fixed } from "../words/format";
import classes from "./MissTable.module.css";

/** Predicted against measured, along and across the target line. */
export function MissTable({ thrown }: { thrown: Throw }) {
  const sd = (value: number | null) => (value === null ? "–" : `± ${fixed(value)} m`);
  return (
    <table className={classes.miss}>
      <thead>
        <tr>
          <th scope="col">
            <span className="visually-hidden">Which</span>
          </th>
          <th scope="col">Along</th>
          <th scope="col">Across</th>
        </tr>
      </thead>
      <tbody>
        <tr>
          <th scope="row">Predicted</th>
          <td>{downrangeWords(thrown.predicted_downrange_error_m)}</td>
          <td>{crossrangeWords(thrown.predicted_crossrange_error_m)}</td>
        </tr>
        <tr className={classes.faint}>
          <th scope="row">1σ</th>
          <td>{sd(thrown.predicted_sd_downrange_m)}</td>
          <td>{sd(thrown.predicted_sd_crossrange_m)}</td>
        </tr>
        <tr className={classes.strong}>
          <th scope="row">Measured</th>
          <td data-testid="measured-downrange">
            {downrangeWords(thrown.measured_downrange_error_m)}
          </td>
          <td data-testid="measured-crossrange">
            {crossrangeWords(thrown.measured_crossrange_error_m)}
          </td>
        </tr>
      </tbody>
    </table>
  );
}
