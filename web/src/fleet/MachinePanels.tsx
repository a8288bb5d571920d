import { Link } from "@tanstack/react-router";
import { AlertList } from "../alerts/AlertList";
import { inOrder } from "../alerts/attention";
import { useClearedAlerts, useOpenAlerts } from "../alerts/useAlerts";
import { useGapRuns } from "../gap/useGap";
import { runWord } from "../gap/words";
import { useMachineId } from "../machine/useMachine";
import type { Machine } from "../session/live";
import { useNow } from "../session/useNow";
import { outcomeWord } from "../throws/outcome";
import { useThrowPage } from "../throws/useThrows";
import { age, count, crossrangeWords, downrangeWords, hours, metres } from "../words/format";
import { localStamp, zonedStamp } from "../words/time";
import classes from "./Fleet.module.css";
import { LinkAge } from "./FleetTable";
import { MissCell } from "./MissCell";
import { type MachineLife, useFleet } from "./useFleet";

const SHOWN = 6;

type OwnProps = { machineId: string };

/** What it throws with, how well, and how to change that. */
export function OnBoardPanel({ machineId }: OwnProps) {
  const record = useFleet().data?.find((row) => row.machine_id === machineId);
  return (
    <section className={classes.panel} aria-label="On board">
      <h2>On board</h2>
      <ul className={classes.rows}>
        {record?.modes.map((mode) => (
          <li key={mode.mode}>
            <span className={classes.mode}>{mode.mode.toUpperCase()}</span>{" "}
            <strong>{mode.policy_id ?? "nothing usable"}</strong>{" "}
            {mode.since_utc && (
              <span className={classes.dim}>since {zonedStamp(mode.since_utc)}</span>
            )}
            <span className={classes.sub}>
              Mean miss <MissCell mode={mode} />
            </span>
          </li>
        ))}
      </ul>
      <Link to="/policies">Deploy or roll back</Link>
    </section>
  );
}

/** Link, software and what the machine has done. */
export function LifePanel({ machine, life }: { machine: Machine; life: MachineLife }) {
  const { counts } = life;
  const { state } = machine;
  const facts: [string, React.ReactNode][] = [
    ["Link", <LinkAge key="link" machine={machine} />],
    ["In control", machine.lease.holder ?? "nobody"],
    ["Load", state ? (state.payload_held ? "held" : "empty") : "not known"],
    ["Records to send", state?.outbox_count ?? "not known"],
    ["Software", state?.software || "not known"],
    ["Site", machine.site],
    ["Known since", zonedStamp(counts.enrolled_utc)],
    [
      "Throws",
      `${counts.throw_count}: ${counts.landed_count} landed, ${counts.aborted_count} aborted`,
    ],
    ["Operating", operatingWords(state?.operating_s, state?.idle_s)],
    ["Time in throws", age(counts.throwing_s)],
    ["Starts", counts.start_count],
    [
      "Stops and faults",
      `${count(counts.stop_count, "stop")}, ${count(counts.fault_count, "fault")}`,
    ],
  ];
  return (
    <section className={classes.panel} aria-label="Machine">
      <h2>Machine</h2>
      <dl className={classes.facts}>
        {facts.map(([name, value]) => (
          <Fact key={name} name={name} value={value} />
        ))}
      </dl>
    </section>
  );
}

/** Hours that the machine's computer has counted; a lost machine's are those that it said last. */
function operatingWords(operating_s?: number | null, idle_s?: number | null): string {
  if (operating_s == null) return "not known";
  return idle_s == null ? hours(operating_s) : `${hours(operating_s)}, idle ${hours(idle_s)}`;
}

function Fact({ name, value }: { name: string; value: React.ReactNode }) {
  return (
    <>
      <dt>{name}</dt>
      <dd>{value}</dd>
    </>
  );
}

/** Newest throws of the machine. */
export function ThrowsPanel({ machineId }: OwnProps) {
  const page = useThrowPage({ machine: machineId }, undefined);
  const rows = page.data?.rows.slice(0, SHOWN) ?? [];
  return (
    <section className={classes.panel} aria-label="Throws">
      <h2>Throws</h2>
      {page.data && rows.length === 0 && <p className={classes.dim}>None yet.</p>}
      <ul className={classes.rows}>
        {rows.map((row) => (
          <li key={row.throw_id}>
            <Link to="/throws/$throwId" params={{ throwId: row.throw_id }}>
              {localStamp(row.created_utc)}
            </Link>{" "}
            {row.mode.toUpperCase()}, {metres(row.target.range_m)}
            <span className={classes.sub}>
              {row.measured_downrange_error_m === null
                ? row.outcome
                  ? outcomeWord(row.outcome)
                  : row.phase
                : `${downrangeWords(row.measured_downrange_error_m)}, ${crossrangeWords(row.measured_crossrange_error_m)}`}
            </span>
          </li>
        ))}
      </ul>
      <Link to="/throws" search={{ machine: machineId }}>
        All throws of {machineId}
      </Link>
    </section>
  );
}

/** Diagnoses of the machine against its twin. */
export function GapPanel({ machineId }: OwnProps) {
  const runs = useGapRuns(machineId);
  const [, choose] = useMachineId();
  return (
    <section className={classes.panel} aria-label="Diagnoses">
      <h2>Diagnoses</h2>
      {runs.isSuccess && runs.rows.length === 0 && <p className={classes.dim}>None yet.</p>}
      <ul className={classes.rows}>
        {runs.rows.slice(0, SHOWN).map((run) => (
          <li key={run.gap_run_id}>
            <Link to="/gap" search={{ run: run.gap_run_id }} onClick={() => choose(machineId)}>
              {localStamp(run.created_utc)}
            </Link>{" "}
            {runWord(run)}
            {run.sentence && <span className={classes.sub}>{run.sentence}</span>}
          </li>
        ))}
      </ul>
    </section>
  );
}

/** Open alerts of the machine, and the newest that are cleared. */
export function AlertsPanel({ machineId }: OwnProps) {
  const now = useNow();
  const open = useOpenAlerts().filter((alert) => alert.machine_id === machineId);
  const cleared = useClearedAlerts({ machine: machineId }).rows.slice(0, SHOWN);
  return (
    <section className={classes.panel} aria-label="Alerts">
      <h2>Alerts</h2>
      {open.length === 0 && <p className={classes.dim}>None is open.</p>}
      <AlertList alerts={[...inOrder(open, now), ...cleared]} label="Alerts of the machine" />
      <Link to="/alerts" search={{ machine: machineId, state: "cleared" }}>
        History of alerts
      </Link>
    </section>
  );
}
