import { Button } from "@mantine/core";
import { Link, useNavigate } from "@tanstack/react-router";
import { Lamp } from "../machine/Lamp";
import { linkQuality } from "../machine/phase";
import { useMachineId } from "../machine/useMachine";
import type { Machine } from "../session/live";
import { useNow } from "../session/useNow";
import { age, crossrangeWords, downrangeWords, unbroken } from "../words/format";
import { Shortened } from "../words/Shortened";
import { ageSeconds, zonedStamp } from "../words/time";
import classes from "./Fleet.module.css";
import { MachineStop } from "./MachineStop";
import { MissCell } from "./MissCell";
import type { FleetRow } from "./rows";
import type { FleetRecord } from "./useFleet";

/** Every machine in one line; on a phone each is a card of its own. */
export function FleetTable({ rows }: { rows: readonly FleetRow[] }) {
  return (
    <table className={classes.table}>
      <thead>
        <tr>
          <th scope="col">Machine</th>
          <th scope="col">State</th>
          <th scope="col">Link</th>
          <th scope="col">On board, mean miss</th>
          <th scope="col">Last throw</th>
          <th scope="col">Alerts</th>
          <th scope="col">In control</th>
          <th scope="col">
            <span className="visually-hidden">Actions</span>
          </th>
        </tr>
      </thead>
      <tbody>
        {rows.map((row) => (
          <Row key={row.machine.machine_id} row={row} />
        ))}
      </tbody>
    </table>
  );
}

function Row({ row: { machine, record, open_count, calling_count } }: { row: FleetRow }) {
  const [, choose] = useMachineId();
  const navigate = useNavigate();
  const id = machine.machine_id;
  const operate = () => {
    choose(id);
    void navigate({ to: "/operate" });
  };
  return (
    <tr data-lost={!machine.link.is_connected || undefined} data-testid={`fleet-${id}`}>
      <th scope="row">
        <Link to="/machines/$machineId" params={{ machineId: id }} className={classes.name}>
          {machine.name || id}
        </Link>
        {machine.name && <span className={classes.dim}> {id}</span>}
        {record && record.tags.length > 0 && (
          <span className={classes.tags}>{record.tags.join(", ")}</span>
        )}
      </th>
      <td data-label="State">
        <Lamp machine={machine} />
      </td>
      <td data-label="Link">
        <LinkAge machine={machine} />
      </td>
      <td data-label="On board, mean miss">
        <Modes record={record} isLive={machine.link.is_connected} />
      </td>
      <td data-label="Last throw">
        <LastThrow record={record} />
      </td>
      <td data-label="Alerts">
        {open_count === 0 ? (
          <span className={classes.dim}>none</span>
        ) : (
          <Link to="/alerts" search={{ machine: id }} data-look={calling_count > 0 || undefined}>
            {calling_count > 0 ? `${calling_count} new of ${open_count}` : `${open_count} seen`}
          </Link>
        )}
      </td>
      <td data-label="In control">{machine.lease.holder ?? "nobody"}</td>
      <td className={classes.actions}>
        <Button variant="default" size="sm" onClick={operate} aria-label={`Operate ${id}`}>
          Operate
        </Button>
        <MachineStop machineId={id} />
      </td>
    </tr>
  );
}

/** A machine without a link shows since when, never the quality of before. */
export function LinkAge({ machine }: { machine: Machine }) {
  const seen = machine.link.last_seen_utc;
  const seen_s = ageSeconds(seen, useNow());
  if (machine.link.is_connected) return <span>{linkQuality(machine).words}</span>;
  if (seen_s === null) return <span>never seen</span>;
  const words = unbroken(`last seen ${age(seen_s)} ago`);
  return <Shortened short={words} whole={`${words}, ${zonedStamp(seen)}`} name="Link" />;
}

function Modes({ record, isLive }: { record: FleetRecord | null; isLive: boolean }) {
  if (!record) return null;
  return (
    <ul className={classes.modes}>
      {record.modes.map((mode) => (
        <li key={mode.mode}>
          <span className={classes.mode}>{mode.mode.toUpperCase()}</span>
          <span>
            {mode.policy_id && mode.policy_sha256 ? (
              <Shortened
                short={mode.policy_id}
                whole={`${mode.policy_id} ${mode.policy_sha256}`}
                name={`Version in ${mode.mode.toUpperCase()}`}
              />
            ) : (
              (mode.policy_id ?? "none")
            )}
            {!isLive && mode.policy_id && <span className={classes.dim}> at last</span>}
          </span>
          <MissCell mode={mode} />
        </li>
      ))}
    </ul>
  );
}

function LastThrow({ record }: { record: FleetRecord | null }) {
  const now = useNow();
  const last = record?.last_throw;
  if (!record || !last) return <span className={classes.dim}>none yet</span>;
  const miss =
    last.measured_downrange_error_m === null
      ? (last.outcome ?? last.phase)
      : `${downrangeWords(last.measured_downrange_error_m)}, ${crossrangeWords(last.measured_crossrange_error_m)}`;
  return (
    <Link to="/throws/$throwId" params={{ throwId: last.throw_id }}>
      {unbroken(`${age(ageSeconds(last.created_utc, now))} ago`)}
      <span className={classes.sub}>{unbroken(miss)}</span>
    </Link>
  );
}
