import { Link } from "@tanstack/react-router";
import { zonedStamp } from "../words/time";
import classes from "./Fleet.module.css";
import { useRetired } from "./useEnrolment";

/** Machines out of service; their throws and audit stay. */
export function RetiredMachines() {
  const { data } = useRetired();
  if (!data || data.length === 0) return null;
  return (
    <details className={classes.retired}>
      <summary>Retired ({data.length})</summary>
      <ul className={classes.rows} aria-label="Retired machines">
        {data.map((machine) => (
          <li key={machine.machine_id}>
            <strong>{machine.name || machine.machine_id}</strong>{" "}
            {machine.name && <span className={classes.dim}>{machine.machine_id}</span>} since{" "}
            {zonedStamp(machine.retired_utc)}{" "}
            <Link to="/throws" search={{ machine: machine.machine_id }}>
              Throws
            </Link>
          </li>
        ))}
      </ul>
    </details>
  );
}
