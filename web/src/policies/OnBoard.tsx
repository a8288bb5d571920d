import { Button, TextInput } from "@mantine/core";
import { useEffect, useRef, useState } from "react";
import { useLive } from "../session/liveStore";
import { useMay } from "../session/useSession";
import { errorWords } from "../words/errors";
import { Hash } from "../words/Hash";
import { instantOf, localStamp, zonedStamp, zoneName } from "../words/time";
import { ConfirmDialog } from "./ConfirmDialog";
import { nameOf, onBoardRowId, outcomeWords, pendingOf, pendingWords } from "./life";
import classes from "./OnBoard.module.css";
import {
  type Deployment,
  type OnBoard as Entry,
  useDeployments,
  useOnBoard,
  usePolicyActions,
} from "./usePolicyLife";

/** What the machine throws with, one press to go back, and what it had at any time. */
export function OnBoard({ machineId }: { machineId: string }) {
  const deployments = useDeployments(machineId);
  const known = deployments.data ?? [];
  const isWaiting = known.some((one) => one.outcome === "pending");
  const now = useOnBoard(machineId, null, isWaiting);
  const { refetch } = now;
  // The machine's answer to a deployment ends the waiting, and changes what is on board.
  const wasWaiting = useRef(false);
  useEffect(() => {
    if (wasWaiting.current && !isWaiting) void refetch();
    wasWaiting.current = isWaiting;
  }, [isWaiting, refetch]);
  return (
    <section className={classes.panel} aria-label={`On board ${machineId}`}>
      <h2>On board {machineId}</h2>
      {now.isError && <p className={classes.refusal}>{errorWords(now.error)}</p>}
      {now.data && now.data.policies.length === 0 && (
        <p className={classes.note}>{machineId} has not started yet, so nothing is known.</p>
      )}
      <ul className={classes.modes}>
        {now.data?.policies.map((entry) => (
          <ModeRow
            key={entry.mode}
            machineId={machineId}
            entry={entry}
            pending={pendingOf(known, entry.mode)}
          />
        ))}
      </ul>
      <HadAt machineId={machineId} />
      {deployments.isError && <p className={classes.refusal}>{errorWords(deployments.error)}</p>}
      <History deployments={known} />
    </section>
  );
}

type RowProps = { machineId: string; entry: Entry; pending: Deployment | null };

function ModeRow({ machineId, entry, pending }: RowProps) {
  const [isOpen, setOpen] = useState(false);
  const mayDeploy = useMay("policy.deploy");
  const lamp = useLive((live) => live.machines[machineId]?.lamp ?? null);
  const { rollBack } = usePolicyActions(machineId);
  const earlier = entry.version_before;
  const why = rollBackRefusal(mayDeploy, entry, pending !== null);
  const close = () => {
    setOpen(false);
    rollBack.reset();
  };
  const rowId = onBoardRowId(machineId, entry.mode);
  return (
    <li id={rowId} tabIndex={-1}>
      <span className={classes.mode}>{entry.mode.toUpperCase()}</span>
      <span>
        <strong>{nameOf(entry)}</strong>{" "}
        <Hash value={entry.policy_sha256} name={`Version in ${entry.mode.toUpperCase()}`} />
        <span className={classes.note}> since {zonedStamp(entry.since_utc)}</span>
        {pending && (
          <span className={classes.pending} role="status">
            {pendingWords(pending, lamp)}
          </span>
        )}
      </span>
      <span className={classes.action}>
        <Button
          variant="default"
          size="md"
          disabled={why !== null}
          aria-label={`Roll back ${entry.mode.toUpperCase()} of ${machineId}`}
          onClick={() => setOpen(true)}
        >
          Roll back
        </Button>
        {why && <span className={classes.note}>{why}</span>}
      </span>
      {isOpen && earlier !== null && (
        <ConfirmDialog
          title={`Roll back ${entry.mode.toUpperCase()} of ${machineId}`}
          action={`Go back to ${earlier}`}
          isPending={rollBack.isPending}
          error={rollBack.error}
          resultId={rowId}
          onConfirm={(reason) =>
            rollBack.mutate({ mode: entry.mode, reason }, { onSuccess: () => setOpen(false) })
          }
          onClose={close}
        >
          <p>
            {machineId} throws in {entry.mode.toUpperCase()} with {earlier} again instead of{" "}
            {nameOf(entry)}, as soon as no plan is armed. Plans that were previewed with{" "}
            {nameOf(entry)} are refused. To throw with {nameOf(entry)} again, deploy it.
          </p>
        </ConfirmDialog>
      )}
    </li>
  );
}

function rollBackRefusal(mayDeploy: boolean, entry: Entry, isPending: boolean) {
  if (!mayDeploy) return "Your role may look, not change.";
  if (isPending) return "Waits for the machine. Deploy what is on board to call it off.";
  if (entry.version_before !== null) return null;
  const taken = entry.rolled_back_from;
  return taken === null
    ? "No earlier version."
    : `No version before ${nameOf(entry)}: ${taken} was rolled back. Deploy it to throw with it again.`;
}

/** What ran on the machine at a moment that a person names. */
function HadAt({ machineId }: { machineId: string }) {
  const [local, setLocal] = useState("");
  const at = instantOf(local);
  return (
    <div className={classes.had}>
      <TextInput
        type="datetime-local"
        step={1}
        label={`What ran on ${machineId} at (${zoneName(at ? new Date(at) : new Date())})`}
        value={local}
        onChange={(event) => setLocal(event.currentTarget.value)}
      />
      {at !== null && <Had machineId={machineId} at={at} />}
    </div>
  );
}

function Had({ machineId, at }: { machineId: string; at: string }) {
  const found = useOnBoard(machineId, at);
  if (found.isError) return <p className={classes.refusal}>{errorWords(found.error)}</p>;
  if (!found.data) return null;
  const all = found.data.policies;
  return (
    <p role="status" data-testid="had-at">
      {all.length === 0
        ? `${machineId} had not started yet.`
        : all.map((one) => `${one.mode.toUpperCase()}: ${nameOf(one)}`).join(", ")}
    </p>
  );
}

function History({ deployments }: { deployments: readonly Deployment[] }) {
  if (deployments.length === 0)
    return <p className={classes.note}>Nothing was deployed to it from here yet.</p>;
  return (
    <div className={classes.scroll}>
      <table className={classes.table}>
        <caption>Deployments, newest first ({zoneName(new Date())})</caption>
        <thead>
          <tr>
            <th scope="col">When</th>
            <th scope="col">Mode</th>
            <th scope="col">Version</th>
            <th scope="col">Who</th>
            <th scope="col">Why</th>
            <th scope="col">What became of it</th>
          </tr>
        </thead>
        <tbody>
          {deployments.map((one) => (
            <tr key={`${one.mode}-${one.deployment_count}-${one.created_utc}`}>
              <td>{localStamp(one.created_utc)}</td>
              <td>{one.mode.toUpperCase()}</td>
              <td>
                {nameOf(one)} <Hash value={one.policy_sha256} name="Version" />
                {one.is_rollback && " (rolled back)"}
              </td>
              <td>{one.created_by}</td>
              <td>{one.reason}</td>
              <td>
                {outcomeWords(one)}
                {one.ended_utc && one.outcome === "switched" && ` ${localStamp(one.ended_utc)}`}
              </td>
            </tr>
          ))}
        </tbody>
      </table>
    </div>
  );
}
