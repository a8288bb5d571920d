import { Link } from "@tanstack/react-router";
import type { Schema } from "../session/client";
import { useLive } from "../session/liveStore";
import { ValidationPanel } from "../validation/ValidationPanel";
import { count, fixed, metres, shortHash } from "../words/format";
import { Hash } from "../words/Hash";
import { zonedStamp } from "../words/time";
import { EvaluationTable } from "./EvaluationTable";
import { LifeStepper } from "./LifeStepper";
import { runningOn } from "./life";
import { PolicyActions } from "./PolicyActions";
import classes from "./PolicyCard.module.css";

type Policy = Schema["PolicyView"];

type Props = { policy: Policy; isOnBoard: boolean; machineId: string | null };

/** One version: what it is for, where it comes from, how well it throws. */
export function PolicyCard({ policy, isOnBoard, machineId }: Props) {
  const { card } = policy;
  const { training } = card;
  // As text: the snapshot of a store has to be the same value while nothing changes.
  const runsOn = useLive((live) => runningOn(live.machines, policy).join(", "));
  return (
    <article className={classes.card} aria-label={policy.policy_id}>
      <header className={classes.head}>
        <span className={classes.mode}>{policy.mode.toUpperCase()}</span>
        <h2>{policy.policy_id}</h2>
        <span className={classes.tags}>
          {policy.is_active && <span className={classes.tag}>active</span>}
          {isOnBoard && <span className={classes.tag}>on board</span>}
        </span>
      </header>
      {policy.problem && (
        <p className={classes.problem} role="alert">
          {policy.problem}
        </p>
      )}
      <LifeStepper policyId={policy.policy_id} sha256={policy.policy_sha256} state={policy.state} />
      {machineId !== null && <PolicyActions policy={policy} machineId={machineId} />}
      <ValidationPanel policy={policy} />
      <dl className={classes.facts}>
        <dt>Runs on</dt>
        <dd>{runsOn || "no machine"}</dd>
        <dt>Targets</dt>
        <dd>{targetWords(card)}</dd>
        <dt>Version</dt>
        <dd>
          <Hash value={policy.policy_sha256} name="Version" />
        </dd>
        <dt>Machine model</dt>
        <dd>
          <Hash value={card.model_sha256} name="Machine model" />
        </dd>
        <dt>Trained</dt>
        <dd>
          {training.environment_step_count.toExponential(1).replace("e+", "e")} steps in{" "}
          {fixed(training.wall_s / 60, 1)} min on {training.device}
        </dd>
        <dt>Commit</dt>
        <dd>{shortHash(training.commit)}</dd>
        <dt>First seen</dt>
        <dd>{zonedStamp(policy.first_seen_utc)}</dd>
        <dt>Thrown</dt>
        <dd>
          <Link to="/throws" search={{ policy: policy.policy_sha256 }}>
            {count(policy.throw_count, "throw")}
          </Link>
        </dd>
      </dl>
      <EvaluationTable evaluations={card.evaluation ?? []} />
    </article>
  );
}

function targetWords(card: Policy["card"]): string {
  const { target_height_min_m: low_m, target_height_max_m: high_m } = card;
  const height = low_m === high_m ? metres(low_m) : `${fixed(low_m)} to ${metres(high_m)}`;
  return `${fixed(card.target_range_min_m)} to ${metres(card.target_range_max_m)}, height ${height}`;
}
