import { Button, Modal, TextInput } from "@mantine/core";
import { type ReactNode, useState } from "react";
import { errorWords } from "../words/errors";
import classes from "./OnBoard.module.css";

const MIN_REASON = 3;

type Props = {
  title: string;
  /** What follows from it, before it is done. */
  children: ReactNode;
  action: string;
  isPending: boolean;
  error: unknown;
  /** What is above still has to be filled in. */
  isBlocked?: boolean;
  onConfirm: (reason: string) => void;
  onClose: () => void;
};

/** A change of what machines throw with: its consequence, who answers for it, and why. */
export function ConfirmDialog(props: Props) {
  const { title, children, action, isPending, error, isBlocked, onConfirm, onClose } = props;
  const [reason, setReason] = useState("");
  const isReady = !isBlocked && reason.trim().length >= MIN_REASON;
  const submit = (event: React.FormEvent) => {
    event.preventDefault();
    if (isReady && !isPending) onConfirm(reason.trim());
  };
  return (
    <Modal opened onClose={onClose} title={title} centered>
      <form onSubmit={submit} className={classes.dialog}>
        {children}
        <TextInput
          label="Why"
          description="Kept in the history with your name"
          value={reason}
          minLength={MIN_REASON}
          maxLength={300}
          required
          data-autofocus
          onChange={(event) => setReason(event.currentTarget.value)}
        />
        {error !== null && error !== undefined && (
          <p className={classes.refusal} role="alert">
            {errorWords(error)}
          </p>
        )}
        <Button type="submit" size="md" fullWidth loading={isPending} disabled={!isReady}>
          {action}
        </Button>
      </form>
    </Modal>
  );
}
