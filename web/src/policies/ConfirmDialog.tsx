import { Button, Modal, TextInput } from "@mantine/core";
import { type ReactNode, useEffect, useRef, useState } from "react";
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
  /** Id of what shows the change: it takes the focus afterwards, in place of what opened the dialog. */
  resultId?: string;
  onConfirm: (reason: string) => void;
  onClose: () => void;
};

/** A change of what machines throw with: its consequence, who answers for it, and why. */
export function ConfirmDialog(props: Props) {
  const { title, children, action, isPending, error, isBlocked, onConfirm, onClose } = props;
  const isConfirmed = useFocusAfter(props.resultId);
  const [reason, setReason] = useState("");
  const isReady = !isBlocked && reason.trim().length >= MIN_REASON;
  const submit = (event: React.FormEvent) => {
    event.preventDefault();
    if (!isReady || isPending) return;
    isConfirmed.current = true;
    onConfirm(reason.trim());
  };
  const cancel = () => {
    isConfirmed.current = false;
    onClose();
  };
  return (
    <Modal opened onClose={cancel} title={title} centered>
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

/**
 * Where the focus goes when the dialog is gone: a change may disable or remove the button that opened it,
 * and the focus would fall to the top of the page.
 */
function useFocusAfter(resultId: string | undefined) {
  const [opener] = useState(() => document.activeElement);
  const isConfirmed = useRef(false);
  const leaving = useRef<ReturnType<typeof setTimeout>>(undefined);
  useEffect(() => {
    clearTimeout(leaving.current);
    return () => {
      // After the dialog has left the page: until then it keeps the focus inside.
      leaving.current = setTimeout(() => {
        const result = isConfirmed.current && resultId ? document.getElementById(resultId) : null;
        const next = result ?? opener;
        if (document.activeElement === document.body && next instanceof HTMLElement) next.focus();
      });
    };
  }, [opener, resultId]);
  return isConfirmed;
}
