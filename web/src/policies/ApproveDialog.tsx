import { Checkbox } from "@mantine/core";
import { useState } from "react";
import type { Schema } from "../session/client";
import { errorWords } from "../words/errors";
import { ConfirmDialog } from "./ConfirmDialog";
import classes from "./OnBoard.module.css";
import { useApprovalBasis } from "./usePolicyLife";

export type Approve = { sha256: string; reason: string; isWithoutValidation: boolean };

type Props = {
  policy: Schema["PolicyView"];
  isPending: boolean;
  error: unknown;
  onConfirm: (wish: Approve) => void;
  onClose: () => void;
};

/** Approves by a passed validation; without one a person has to say so. */
export function ApproveDialog({ policy, isPending, error, onConfirm, onClose }: Props) {
  const [isWithout, setWithout] = useState(false);
  const sha256 = policy.policy_sha256;
  const basis = useApprovalBasis(sha256);
  const isValidated = basis.data?.is_validated === true;
  return (
    <ConfirmDialog
      title={`Approve ${policy.policy_id}`}
      action={isWithout && !isValidated ? "Approve without a validation" : "Approve"}
      isPending={isPending}
      error={error}
      isBlocked={!basis.data || !(isValidated || isWithout)}
      onConfirm={(reason) =>
        onConfirm({ sha256, reason, isWithoutValidation: isWithout && !isValidated })
      }
      onClose={onClose}
    >
      <p>
        The site signs network, card, mode and machine model. Machines of this site may then load
        it; nothing moves to it by that.
      </p>
      {basis.isError && <p className={classes.refusal}>{errorWords(basis.error)}</p>}
      {basis.data && (
        <p className={isValidated ? undefined : classes.refusal} data-testid="approval-basis">
          {basis.data.sentence}
        </p>
      )}
      {basis.data && !isValidated && (
        <Checkbox
          label="Approve it without a validation that passed; history and audit say so"
          checked={isWithout}
          onChange={(event) => setWithout(event.currentTarget.checked)}
        />
      )}
    </ConfirmDialog>
  );
}
