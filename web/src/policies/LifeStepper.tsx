import { errorWords } from "../words/errors";
import { zonedStamp } from "../words/time";
import classes from "./LifeStepper.module.css";
import { lifeSteps, stateWords } from "./life";
import { type PolicyState, usePolicyHistory } from "./usePolicyLife";

type Props = { policyId: string; sha256: string; state: PolicyState };

/** Where a version is in its life, and who brought it there, when and why. */
export function LifeStepper({ policyId, sha256, state }: Props) {
  const history = usePolicyHistory(sha256);
  return (
    <div className={classes.life}>
      <ol className={classes.steps} aria-label={`Life of ${policyId}`}>
        {lifeSteps(state, history.data ?? []).map((step) => (
          <li
            key={step.state}
            className={classes.step}
            data-place={step.place}
            aria-current={step.place === "now" ? "step" : undefined}
          >
            {stateWords(step.state)}
          </li>
        ))}
      </ol>
      {history.isError && <p className={classes.refusal}>{errorWords(history.error)}</p>}
      {history.data && history.data.length > 0 && (
        <details className={classes.history}>
          <summary>Who, when and why</summary>
          <ol>
            {history.data.map((row) => (
              <li key={`${row.at_utc}-${row.to_state}`}>
                <strong>{stateWords(row.to_state)}</strong>
                {row.evidence.is_without_validation === true && " without a validation"}{" "}
                {zonedStamp(row.at_utc)} by {row.actor}: {row.reason}
              </li>
            ))}
          </ol>
        </details>
      )}
    </div>
  );
}
