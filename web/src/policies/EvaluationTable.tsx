import { fixed, percent, signed } from "../words/format";
import classes from "./EvaluationTable.module.css";
import { readEvaluations } from "./evaluation";

/** How the version threw in simulators, per target range. */
export function EvaluationTable({ evaluations }: { evaluations: readonly unknown[] }) {
  const read = readEvaluations(evaluations);
  if (read.length === 0) return <p className={classes.none}>No evaluation on the card.</p>;
  return read.map((evaluation) => (
    <table key={evaluation.where} className={classes.table}>
      <caption>Evaluated on: {evaluation.where}</caption>
      <thead>
        <tr>
          <th scope="col">Range, m</th>
          <th scope="col">n</th>
          <th scope="col">Landed</th>
          <th scope="col">Along: mean, sd</th>
          <th scope="col">Across: mean, sd</th>
        </tr>
      </thead>
      <tbody>
        {evaluation.rows.map((row) => (
          <tr key={row.range_m}>
            <th scope="row">{fixed(row.range_m)}</th>
            <td>{fixed(row.throw_count, 0)}</td>
            <td>{percent(row.success_ratio, 1)}</td>
            <td>
              {signed(row.mean_downrange_error_m)}, {fixed(row.sd_downrange_m)}
            </td>
            <td>
              {signed(row.mean_crossrange_error_m)}, {fixed(row.sd_crossrange_m)}
            </td>
          </tr>
        ))}
      </tbody>
    </table>
  ));
}
