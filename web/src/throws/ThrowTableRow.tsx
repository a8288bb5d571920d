import { Link } from "@tanstack/react-router";
import { memo } from "react";
import type { Throw } from "../session/live";
import { bearingShort, crossrangeWords, downrangeWords, fixed, signed } from "../words/format";
import { Shortened } from "../words/Shortened";
import { localStamp, shortStamp } from "../words/time";
import { MissBar } from "./MissBar";
import { outcomeSentence, statusWord } from "./outcome";
import classes from "./ThrowTable.module.css";

type Props = {
  row: Throw;
  limit_m: number;
  isSelected: boolean;
  onSelect: (throwId: string) => void;
  onOpen: (throwId: string) => void;
  isCompared: boolean;
  onCompare: (row: Throw, isCompared: boolean) => void;
};

export const ThrowTableRow = memo(function ThrowTableRow(props: Props) {
  const { row, limit_m, isSelected, onSelect, onOpen, isCompared, onCompare } = props;
  return (
    <tr
      id={`throw-${row.throw_id}`}
      data-throw={row.throw_id}
      aria-selected={isSelected}
      className={classes.row}
      onClick={() => onSelect(row.throw_id)}
      onDoubleClick={() => onOpen(row.throw_id)}
    >
      <td>
        <input
          type="checkbox"
          aria-label={`Compare the throw of ${localStamp(row.created_utc)}`}
          checked={isCompared}
          onChange={(event) => onCompare(row, event.currentTarget.checked)}
        />
      </td>
      <td>
        <Link to="/throws/$throwId" params={{ throwId: row.throw_id }} className={classes.link}>
          {shortStamp(row.created_utc)}
        </Link>
      </td>
      <td>{row.machine_id}</td>
      <td>{targetWords(row)}</td>
      <td>{bearingShort(row.target.azimuth_rad)}</td>
      <td>
        <Miss
          measured_m={row.measured_downrange_error_m}
          predicted_m={row.predicted_downrange_error_m}
          limit_m={limit_m}
          words={downrangeWords}
        />
      </td>
      <td>
        <Miss
          measured_m={row.measured_crossrange_error_m}
          predicted_m={row.predicted_crossrange_error_m}
          limit_m={limit_m}
          words={crossrangeWords}
        />
      </td>
      <td data-outcome={row.outcome ?? row.phase} className={classes.outcome}>
        {row.detail ? (
          <Shortened short={statusWord(row)} whole={outcomeSentence(row)} name="Outcome" />
        ) : (
          statusWord(row)
        )}
      </td>
      <td className={classes.policy}>
        <Shortened
          short={row.policy_id}
          whole={`${row.policy_id} ${row.policy_sha256}`}
          name="Policy"
        />
      </td>
      <td>{row.operator}</td>
      <td className={classes.right}>{fixed(row.pace_ratio)}</td>
    </tr>
  );
});

/** "2D 9.00", off the ground "2D 9.00 +1.20". */
function targetWords({ mode, target }: Throw): string {
  const height = fixed(target.z_m) === fixed(0) ? "" : ` ${signed(target.z_m)}`;
  return `${mode.toUpperCase()} ${fixed(target.range_m)}${height}`;
}

type MissProps = {
  measured_m: number | null;
  predicted_m: number | null;
  limit_m: number;
  words: (error_m: number | null) => string;
};

function Miss({ measured_m, predicted_m, limit_m, words }: MissProps) {
  return (
    <span className={classes.miss}>
      <MissBar
        measured_m={measured_m}
        predicted_m={predicted_m}
        limit_m={limit_m}
        words={words(measured_m)}
      />
      <span className={classes.missText} aria-hidden>
        {signed(measured_m)}
      </span>
    </span>
  );
}
