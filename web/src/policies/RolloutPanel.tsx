import { Button } from "@mantine/core";
import { useState } from "react";
import type { Schema } from "../session/client";
import { useMay } from "../session/useSession";
import { ScrollTable } from "../validation/ScrollTable";
import { errorWords } from "../words/errors";
import { percent } from "../words/format";
import { localStamp, zoneName } from "../words/time";
import { ConfirmDialog } from "./ConfirmDialog";
import classes from "./OnBoard.module.css";
import { RolloutDialog } from "./RolloutDialog";
import {
  CHANGE_WORDS,
  changesOf,
  consequence,
  figureWords,
  MACHINE_WORDS,
  STATE_WORDS,
} from "./rolloutWords";
import {
  isOpen,
  type Rollout,
  type RolloutChange,
  useRolloutActions,
  useRollouts,
} from "./useRollouts";

/** Rollouts: one is started, what is open with its machines, what was before. */
export function RolloutPanel({ policies }: { policies: readonly Schema["PolicyView"][] }) {
  const rollouts = useRollouts();
  const mayDeploy = useMay("policy.deploy");
  const [isStarting, setStarting] = useState(false);
  const approved = policies.filter((one) => one.state === "approved" && one.is_present);
  const all = rollouts.data ?? [];
  const open = all.filter(isOpen);
  const ended = all.filter((one) => !isOpen(one));
  return (
    <section className={classes.panel} aria-label="Rollouts">
      <h2>Rollouts</h2>
      {rollouts.isError && <p className={classes.refusal}>{errorWords(rollouts.error)}</p>}
      {rollouts.data && open.length === 0 && (
        <p className={classes.note}>
          No rollout is open. A rollout brings a version to machines in stages and takes it back
          where it throws worse.
        </p>
      )}
      {open.map((one) => (
        <OneRollout key={one.rollout_id} rollout={one} mayDeploy={mayDeploy} />
      ))}
      <div>
        <Button
          variant="default"
          size="md"
          disabled={!mayDeploy || approved.length === 0}
          onClick={() => setStarting(true)}
        >
          Start a rollout
        </Button>{" "}
        {!mayDeploy && <span className={classes.note}>Your role may look, not deploy.</span>}
        {mayDeploy && approved.length === 0 && (
          <span className={classes.note}>No version is approved.</span>
        )}
      </div>
      {ended.length > 0 && (
        <details>
          <summary>Earlier rollouts</summary>
          {ended.map((one) => (
            <OneRollout key={one.rollout_id} rollout={one} mayDeploy={false} />
          ))}
        </details>
      )}
      {isStarting && <RolloutDialog policies={approved} onClose={() => setStarting(false)} />}
    </section>
  );
}

function OneRollout({ rollout, mayDeploy }: { rollout: Rollout; mayDeploy: boolean }) {
  const [asking, setAsking] = useState<RolloutChange | null>(null);
  const { change } = useRolloutActions();
  const last = rollout.steps.at(-1);
  const name = `${rollout.policy_id} in ${rollout.mode.toUpperCase()}`;
  const close = () => {
    setAsking(null);
    change.reset();
  };
  return (
    <article aria-label={`Rollout of ${name}`}>
      <h3>
        {name}: {STATE_WORDS[rollout.state]}, stage {rollout.stage_count + 1} of{" "}
        {rollout.stages.length}
      </h3>
      <p
        role={isOpen(rollout) ? "status" : undefined}
        className={rollout.state === "paused" ? classes.refusal : undefined}
      >
        {last?.sentence}
      </p>
      <ScrollTable label={`Machines of the rollout of ${name}`}>
        <caption>
          m, 95 % intervals. A machine passes after {rollout.throws_count} measured throws that are
          no worse; at most {percent(rollout.false_alarm_ratio)} of rollouts of a version that is no
          worse are rolled back. Of machines with 300 throws before, twelve throws find a doubled
          spread in 91 of 100.
        </caption>
        <thead>
          <tr>
            <th scope="col">Machine</th>
            <th scope="col">Stage</th>
            <th scope="col">State</th>
            <th scope="col">Throws</th>
            <th scope="col">Along, since</th>
            <th scope="col">Along, before</th>
            <th scope="col">Across, since</th>
            <th scope="col">Across, before</th>
          </tr>
        </thead>
        <tbody>
          {rollout.machines.map((one) => (
            <tr key={one.machine_id}>
              <th scope="row">{one.machine_id}</th>
              <td>
                {one.stage_count + 1} ({rollout.stages[one.stage_count]?.name})
              </td>
              <td data-look={one.state === "worse" || one.state === "error" || undefined}>
                {MACHINE_WORDS[one.state]}
                {one.sentence && `: ${one.sentence}`}
              </td>
              <td>
                {one.since?.throw_count ?? 0} of {rollout.throws_count}
                {one.failed_count > 0 && `, ${one.failed_count} failed`}
              </td>
              <td>{figureWords(one.since, "downrange")}</td>
              <td>{figureWords(one.before, "downrange")}</td>
              <td>{figureWords(one.since, "crossrange")}</td>
              <td>{figureWords(one.before, "crossrange")}</td>
            </tr>
          ))}
        </tbody>
      </ScrollTable>
      {mayDeploy && (
        <p>
          {changesOf(rollout).map((one) => (
            <Button
              key={one}
              variant="default"
              size="md"
              mr="xs"
              aria-label={`${CHANGE_WORDS[one]}: rollout of ${name}`}
              onClick={() => setAsking(one)}
            >
              {CHANGE_WORDS[one]}
            </Button>
          ))}
        </p>
      )}
      <details>
        <summary>What happened ({zoneName(new Date())})</summary>
        <ol>
          {rollout.steps.map((step) => (
            <li key={`${step.at_utc}-${step.state}`}>
              <strong>{STATE_WORDS[step.state]}</strong>, stage {step.stage_count + 1},{" "}
              <time dateTime={step.at_utc}>{localStamp(step.at_utc)}</time> by {step.actor}:{" "}
              {step.sentence}
            </li>
          ))}
        </ol>
      </details>
      {asking && (
        <ConfirmDialog
          title={`${CHANGE_WORDS[asking]}: rollout of ${name}`}
          action={CHANGE_WORDS[asking]}
          isPending={change.isPending}
          error={change.error}
          onConfirm={(reason) =>
            change.mutate(
              { id: rollout.rollout_id, change: asking, reason },
              { onSuccess: () => setAsking(null) },
            )
          }
          onClose={close}
        >
          <p>{consequence(asking, rollout)}</p>
        </ConfirmDialog>
      )}
    </article>
  );
}
