import { Button, Progress } from "@mantine/core";
import { useState } from "react";
import type { Schema } from "../session/client";
import { useMay } from "../session/useSession";
import { errorWords } from "../words/errors";
import { percent } from "../words/format";
import { zonedStamp } from "../words/time";
import { GateTable } from "./GateTable";
import { StartDialog } from "./StartDialog";
import { UnitResults } from "./UnitResults";
import { isOpen, useValidation, useValidationActions } from "./useValidation";
import classes from "./Validation.module.css";
import { validationWords } from "./words";

type Props = { policy: Schema["PolicyView"] };

/** The newest validation of a version: start, progress, gates with their numbers, throws by machine. */
export function ValidationPanel({ policy }: Props) {
  const [isAsking, setAsking] = useState(false);
  const validation = useValidation(policy.policy_sha256);
  const mayValidate = useMay("policy.validate");
  const { start, cancel } = useValidationActions(policy.policy_sha256);
  if (validation.isError)
    return (
      <section className={classes.panel} aria-label={`Validation of ${policy.policy_id}`}>
        <p className={classes.refusal}>{errorWords(validation.error)}</p>
      </section>
    );
  if (validation.data === undefined) return null;
  const found = validation.data;
  const open = isOpen(found);
  const close = () => {
    setAsking(false);
    start.reset();
  };
  return (
    <section className={classes.panel} aria-label={`Validation of ${policy.policy_id}`}>
      <h3>Validation</h3>
      {found === null ? (
        <p>Not validated yet.</p>
      ) : (
        <p>
          <span className={classes.verdict} data-look={found.is_passed === false || undefined}>
            {validationWords(found)}
          </span>
          <span className={classes.note}>
            {" "}
            Asked for by {found.created_by}, {zonedStamp(found.created_utc)}
          </span>
        </p>
      )}
      {found !== null && open && (
        <>
          <Progress
            value={100 * found.progress_ratio}
            size="lg"
            aria-label={`Progress of the validation of ${policy.policy_id}`}
          />
          <p aria-live="polite">
            {found.step}, {percent(found.progress_ratio)}
          </p>
        </>
      )}
      {mayValidate && (
        <div className={classes.buttons}>
          {open ? (
            <Button
              variant="default"
              size="md"
              loading={cancel.isPending}
              aria-label={`Cancel the validation of ${policy.policy_id}`}
              onClick={() => cancel.mutate()}
            >
              Cancel
            </Button>
          ) : (
            <Button
              variant="default"
              size="md"
              disabled={!policy.is_present}
              aria-label={`Validate ${policy.policy_id}`}
              onClick={() => setAsking(true)}
            >
              {found === null ? "Validate" : "Validate again"}
            </Button>
          )}
        </div>
      )}
      {cancel.isError && (
        <p className={classes.refusal} role="alert">
          {errorWords(cancel.error)}
        </p>
      )}
      {found?.result && (
        <>
          <GateTable checks={found.result.checks} policyId={policy.policy_id} />
          <UnitResults validation={found} result={found.result} />
        </>
      )}
      {isAsking && (
        <StartDialog
          policyId={policy.policy_id}
          isPending={start.isPending}
          error={start.error}
          onStart={(request) => start.mutate(request, { onSuccess: close })}
          onClose={close}
        />
      )}
    </section>
  );
}
