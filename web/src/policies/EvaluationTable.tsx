import { fixed, percent, signed } from "../words/format";
import classes from "./EvaluationTable.module.css";
import { type EvaluationRow, readEvaluations } from "./evaluation";
import { RangePlot } from "./RangePlot";

/** How the version threw in simulators, per target range. */
export function EvaluationTable({ evaluations }: { evaluations: readonly unknown[] }) {
  const read = readEvaluations(evaluations);
  if (read.length === 0) return <p className={classes.none}>No evaluation on the card.</p>;
  return read.map((evaluation) => (
    <div key={evaluation.id} className={classes.evaluation}>
      <h3>Evaluated on: {evaluation.where}</h3>
      <RangePlot rows={evaluation.rows} where={evaluation.where} />
      <Rows rows={evaluation.rows} />
    </div>
  ));
}

function Rows({ rows }: { rows: readonly EvaluationRow[] }) {
  const hasHeights = rows.some((row) => row.height_m !== 0);
  return (
    <table className={classes.table}>
      <thead>
        <tr>
          <th scope="col">Range, m</th>
          {hasHeights && <th scope="col">Height, m</th>}
          <th scope="col">n</th>
          <th scope="col">Landed</th>
          <th scope="col">Along, m: mean, sd</th>
          <th scope="col">Across, m: mean, sd</th>
        </tr>
      </thead>
      <tbody>
        {rows.map((row) => (
          <tr key={`${row.range_m} ${row.height_m}`}>
            <th scope="row">{fixed(row.range_m)}</th>
            {hasHeights && <td>{signed(row.height_m, 1)}</td>}
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
  );
}
