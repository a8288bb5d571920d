import { Button } from "@mantine/core";
import { Link } from "@tanstack/react-router";
import type { Throw } from "../session/live";
import {
  bearingWords,
  crossrangeWords,
  downrangeWords,
  fixed,
  metres,
  signed,
} from "../words/format";
import { shortStamp } from "../words/time";
import classes from "./CompareTable.module.css";
import { statusWord } from "./outcome";

const LINES: readonly { label: string; of: (row: Throw) => string }[] = [
  { label: "Machine", of: (row) => row.machine_id },
  { label: "Mode", of: (row) => row.mode.toUpperCase() },
  { label: "Target", of: (row) => metres(row.target.range_m) },
  { label: "Height", of: (row) => `${signed(row.target.z_m)} m` },
  { label: "Bearing", of: (row) => bearingWords(row.target.azimuth_rad) },
  { label: "Pace", of: (row) => fixed(row.pace_ratio) },
  { label: "Policy", of: (row) => row.policy_id },
  { label: "Outcome", of: statusWord },
  { label: "Predicted along", of: (row) => downrangeWords(row.predicted_downrange_error_m) },
  { label: "Measured along", of: (row) => downrangeWords(row.measured_downrange_error_m) },
  { label: "Predicted across", of: (row) => crossrangeWords(row.predicted_crossrange_error_m) },
  { label: "Measured across", of: (row) => crossrangeWords(row.measured_crossrange_error_m) },
];

type Props = { throws: readonly Throw[]; onClear: () => void };

/** Throws side by side; a line in which they differ stands out. */
export function CompareTable({ throws, onClear }: Props) {
  return (
    <section className={classes.compare} aria-label="Comparison">
      <table className={classes.table}>
        <thead>
          <tr>
            <th scope="col">
              <Button size="compact-xs" variant="default" onClick={onClear}>
                Clear
              </Button>
            </th>
            {throws.map((row) => (
              <th key={row.throw_id} scope="col">
                <Link to="/throws/$throwId" params={{ throwId: row.throw_id }}>
                  {shortStamp(row.created_utc)}
                </Link>
              </th>
            ))}
          </tr>
        </thead>
        <tbody>
          {LINES.map(({ label, of }) => {
            const values = throws.map(of);
            return (
              <tr key={label} data-differs={new Set(values).size > 1 || undefined}>
                <th scope="row">{label}</th>
                {throws.map((row, index) => (
                  <td key={row.throw_id}>{values[index]}</td>
                ))}
              </tr>
            );
          })}
        </tbody>
      </table>
    </section>
  );
}
