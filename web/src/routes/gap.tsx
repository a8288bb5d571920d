import { useNavigate, useSearch } from "@tanstack/react-router";
import { useEffect, useState } from "react";
import { useOpenAlerts } from "../alerts/useAlerts";
import { DriftOffers } from "../gap/DriftOffers";
import { RunList } from "../gap/RunList";
import { RunHead } from "../gap/result/RunHead";
import { RunResult } from "../gap/result/RunResult";
import { StartPanel } from "../gap/start/StartPanel";
import { useGapRun, useGapRuns } from "../gap/useGap";
import type { Run } from "../gap/words";
import { useMachineId } from "../machine/useMachine";
import { GateSentence } from "../operate/GateSentence";
import { errorWords } from "../words/errors";
import classes from "./gap.module.css";

/** Gap: why a machine and its twin differ; throws at the left, what was found at the right. */
export function GapPage() {
  const [machineId] = useMachineId();
  const wanted = useWantedRun(machineId);
  if (machineId === null) {
    return <GateSentence sentence="No machine is known yet. Fleet shows how one is added." />;
  }
  return <GapOf key={machineId} machineId={machineId} wanted={wanted} />;
}

/** The run that the address names; it goes when another machine is chosen, whose run it is not. */
function useWantedRun(machineId: string | null): string | undefined {
  const { run } = useSearch({ from: "/frame/gap" });
  const navigate = useNavigate({ from: "/gap" });
  const [of, setOf] = useState(machineId);
  const isOthers = of !== null && of !== machineId;
  useEffect(() => {
    if (isOthers && run) void navigate({ search: {}, replace: true });
    else if (of !== machineId) setOf(machineId);
  }, [isOthers, run, of, machineId, navigate]);
  return isOthers ? undefined : run;
}

type GapOfProps = { machineId: string; wanted: string | undefined };

function GapOf({ machineId, wanted }: GapOfProps) {
  const navigate = useNavigate({ from: "/gap" });
  const runs = useGapRuns(machineId);
  const drift = useOpenAlerts().find(
    (alert) => alert.rule === "drift" && alert.machine_id === machineId,
  );
  const shown = wanted ?? firstShown(runs.rows)?.gap_run_id;
  const select = (run: string) => void navigate({ search: { run } });
  return (
    <div className={classes.page}>
      <h1 className="visually-hidden">Gap between machine and twin</h1>
      <div className={classes.side}>
        {drift && (
          <section className={classes.drift} aria-label="Drift">
            <p>{drift.text}</p>
            <DriftOffers alert={drift} />
          </section>
        )}
        <StartPanel machineId={machineId} onStarted={select} />
        {runs.isError ? (
          <GateSentence sentence={errorWords(runs.error)} />
        ) : (
          <RunList runs={runs} selected={shown ?? null} onSelect={select} />
        )}
      </div>
      <div className={classes.main}>
        {shown ? (
          <OneRun machineId={machineId} runId={shown} onStarted={select} />
        ) : (
          runs.isSuccess && (
            <GateSentence
              sentence={`${machineId} was not diagnosed yet. Choose throws at the left and start: it takes some minutes and does not touch the machine.`}
            />
          )
        )}
      </div>
    </div>
  );
}

/** The newest that says something: one that was cancelled says nothing. */
const firstShown = (rows: readonly Run[]) =>
  rows.find((run) => run.state !== "cancelled") ?? rows[0];

type OneRunProps = { machineId: string; runId: string; onStarted: (runId: string) => void };

function OneRun({ machineId, runId, onStarted }: OneRunProps) {
  const run = useGapRun(machineId, runId);
  if (run.isError && !run.data) return <GateSentence sentence={errorWords(run.error)} />;
  if (!run.row || !run.data) return null;
  const { result: found, words, throw_ids, reference_throw_ids } = run.data;
  const again = {
    throw_ids,
    reference_throw_ids: reference_throw_ids.length > 0 ? reference_throw_ids : null,
    against: reference_throw_ids.length > 0 ? null : ("type" as const),
  };
  return (
    <>
      <RunHead key={runId} run={run.row} words={words} again={again} onStarted={onStarted} />
      {found && words && <RunResult key={runId} run={run.row} found={found} words={words} />}
    </>
  );
}
