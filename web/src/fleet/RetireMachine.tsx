import { Button, Modal, TextInput } from "@mantine/core";
import { useState } from "react";
import { errorWords } from "../words/errors";
import classes from "./Fleet.module.css";
import { useRetire } from "./useEnrolment";

const LEAST_LETTERS = 3;

type Props = { machineId: string; onClose: () => void; onDone: () => void };

/** Out of service for good; the history stays. */
export function RetireMachine({ machineId, onClose, onDone }: Props) {
  const [reason, setReason] = useState("");
  const retire = useRetire(machineId, onDone);
  const submit = (event: React.FormEvent) => {
    event.preventDefault();
    retire.mutate(reason.trim());
  };
  return (
    <Modal opened onClose={onClose} title={`Retire ${machineId}`} centered>
      <form onSubmit={submit} className={classes.dialog}>
        <p>
          Its password is void at once, and its id is never used again. Throws, alerts and audit
          stay.
        </p>
        <TextInput
          label="Reason"
          value={reason}
          maxLength={300}
          required
          data-autofocus
          onChange={(event) => setReason(event.currentTarget.value)}
        />
        {retire.isError && (
          <p className={classes.refusal} role="alert">
            {errorWords(retire.error)}
          </p>
        )}
        <Button
          type="submit"
          size="md"
          fullWidth
          loading={retire.isPending}
          disabled={reason.trim().length < LEAST_LETTERS}
        >
          Retire {machineId}
        </Button>
      </form>
    </Modal>
  );
}
