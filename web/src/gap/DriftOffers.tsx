import { Button } from "@mantine/core";
import { Link, useNavigate } from "@tanstack/react-router";
import type { Alert } from "../alerts/attention";
import { useMachineId } from "../machine/useMachine";
import type { Schema } from "../session/client";
import { useMay } from "../session/useSession";
import { errorWords } from "../words/errors";
import { count } from "../words/format";
import classes from "./DriftOffers.module.css";
import { useDrifts, useStartDriftRun } from "./useDrifts";

type Drift = Schema["DriftView"];

/** Drifts that an alert tells of, each with its diagnosis or the button that starts it. */
export function DriftOffers({ alert }: { alert: Alert }) {
  const machineId = alert.machine_id ?? "";
  const drifts = useDrifts(machineId, alert.text);
  if (drifts.isError) return <p className={classes.note}>{errorWords(drifts.error)}</p>;
  return (
    <>
      {drifts.data?.map((drift) => (
        <Offer key={drift.mode} machineId={machineId} drift={drift} />
      ))}
    </>
  );
}

function Offer({ machineId, drift }: { machineId: string; drift: Drift }) {
  const [, choose] = useMachineId();
  const navigate = useNavigate();
  const mayRun = useMay("gap.run");
  const start = useStartDriftRun(machineId, drift.mode);
  const mode = drift.mode.toUpperCase();
  if (drift.gap_run_id !== null) {
    return (
      <p className={classes.offer}>
        <Link
          to="/gap"
          search={{ run: drift.gap_run_id }}
          onClick={() => choose(machineId)}
        >{`Diagnosis of the ${mode} drift`}</Link>
      </p>
    );
  }
  const open = (run: Schema["GapRunRow"]) => {
    choose(machineId);
    void navigate({ to: "/gap", search: { run: run.gap_run_id } });
  };
  const problem = mayRun ? drift.problem : "Your role may look, not start a diagnosis.";
  return (
    <div className={classes.offer}>
      <Button
        size="sm"
        variant="default"
        disabled={problem !== ""}
        loading={start.isPending}
        onClick={() => start.mutate(undefined, { onSuccess: open })}
      >
        Diagnose the {mode} drift
      </Button>
      <p className={classes.note}>{problem || comparedWords(drift)}</p>
      {start.isError && (
        <p className={classes.note} role="alert">
          {errorWords(start.error)}
        </p>
      )}
    </div>
  );
}

function comparedWords({ diagnosed_throw_count, reference_throw_count }: Drift): string {
  const diagnosed = `${count(diagnosed_throw_count, "throw")} since the change`;
  return reference_throw_count > 0
    ? `${diagnosed} against ${reference_throw_count} of before`
    : `${diagnosed}; none of before has a log, so against the kept throws or the type`;
}
