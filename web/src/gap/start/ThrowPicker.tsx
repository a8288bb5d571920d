import type { Throw } from "../../session/live";
import { fixed, signed } from "../../words/format";
import { shortStamp, zoneName } from "../../words/time";
import classes from "./ThrowPicker.module.css";

type Props = {
  label: string;
  throws: readonly Throw[];
  chosen: ReadonlySet<string>;
  onChange: (chosen: ReadonlySet<string>) => void;
};

/** Throws by hand: a box for each, and one for all that are listed; `chosen` may hold others as well. */
export function ThrowPicker({ label, throws, chosen, onChange }: Props) {
  const isAll = throws.length > 0 && throws.every((row) => chosen.has(row.throw_id));
  const toggle = (throwId: string) => {
    const next = new Set(chosen);
    if (!next.delete(throwId)) next.add(throwId);
    onChange(next);
  };
  const toggleAll = () => {
    const next = new Set(chosen);
    for (const row of throws) isAll ? next.delete(row.throw_id) : next.add(row.throw_id);
    onChange(next);
  };
  return (
    <div className={classes.scroll}>
      <table className={classes.table} aria-label={`${label}, newest first`}>
        <thead>
          <tr>
            <th scope="col">
              <label className={classes.pick}>
                <input type="checkbox" checked={isAll} onChange={toggleAll} />
                <span className="visually-hidden">All</span>
              </label>
            </th>
            <th scope="col">Time, {zoneName(new Date())}</th>
            <th scope="col">Mode</th>
            <th scope="col">At, m</th>
            <th scope="col" className={classes.along}>
              Along, m
            </th>
          </tr>
        </thead>
        <tbody>
          {throws.map((row) => (
            <tr key={row.throw_id}>
              <td>
                <label className={classes.pick}>
                  <input
                    type="checkbox"
                    checked={chosen.has(row.throw_id)}
                    onChange={() => toggle(row.throw_id)}
                  />
                  <span className="visually-hidden">Throw of {shortStamp(row.created_utc)}</span>
                </label>
              </td>
              <td>{shortStamp(row.created_utc).slice(0, -3)}</td>
              <td>{row.mode.toUpperCase()}</td>
              <td>{fixed(row.target.range_m)}</td>
              <td className={classes.along}>{signed(row.measured_downrange_error_m)}</td>
            </tr>
          ))}
        </tbody>
      </table>
    </div>
  );
}
