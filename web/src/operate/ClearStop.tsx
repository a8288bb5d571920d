import { Button, Checkbox, Modal, TextInput } from "@mantine/core";
import { useMutation } from "@tanstack/react-query";
import { useState } from "react";
import { api, take } from "../session/client";
import type { Machine } from "../session/live";
import { useSession } from "../session/useSession";
import { errorWords } from "../words/errors";
import classes from "./Panel.module.css";

const MIN_REASON = 3;

type Props = { machine: Machine; onClose: () => void };

/**
 * Clearing a stop or fault: who sees the machine says so, and why it may move again. It names the latch that
 * the person has read; another one that comes meanwhile has to be read first.
 */
export function ClearStop({ machine, onClose }: Props) {
  const name = machine.machine_id;
  const person = useSession()?.username ?? "";
  const latch = machine.state?.latch_id || "none";
  const [read, setRead] = useState(latch);
  const [isSighted, setSighted] = useState(false);
  const [reason, setReason] = useState("");
  const isOther = read !== latch;
  const clear = useMutation({
    mutationFn: () =>
      take(
        api.POST("/api/v1/machines/{machine_id}/stop/clear", {
          params: { path: { machine_id: name } },
          body: { latch_id: read, is_sighted: true, reason: reason.trim() },
        }),
      ),
    onSuccess: onClose,
  });
  const readAgain = () => {
    setRead(latch);
    setSighted(false);
    clear.reset();
  };
  const submit = (event: React.FormEvent) => {
    event.preventDefault();
    if (!isOther && isSighted && reason.trim().length >= MIN_REASON) clear.mutate();
  };
  const why = machine.state?.latched_reason || machine.state?.fault || "no reason given";
  return (
    <Modal opened onClose={onClose} title={`Clear the stop of ${name}`} centered>
      <form onSubmit={submit} className={classes.clear} data-testid="clear-stop">
        <p>
          Latched now: <strong>{why}</strong>
        </p>
        {isOther ? (
          <>
            <p className={classes.refusal} role="alert">
              It was stopped again since you opened this. Look at the machine again.
            </p>
            <Button variant="default" size="md" onClick={readAgain}>
              I have read the new reason
            </Button>
          </>
        ) : (
          <>
            <Checkbox
              size="md"
              checked={isSighted}
              onChange={(event) => setSighted(event.currentTarget.checked)}
              label={`I see ${name} and nobody is in reach of it`}
            />
            <TextInput
              label="Why it may move again"
              value={reason}
              minLength={MIN_REASON}
              maxLength={300}
              required
              onChange={(event) => setReason(event.currentTarget.value)}
            />
            <p className={classes.note}>
              Recorded with your name, {person}. It must be armed anew.
            </p>
            {clear.error && (
              <p className={classes.refusal} role="alert">
                {errorWords(clear.error)}
              </p>
            )}
            <Button
              type="submit"
              size="md"
              fullWidth
              loading={clear.isPending}
              disabled={!isSighted || reason.trim().length < MIN_REASON}
            >
              Clear
            </Button>
          </>
        )}
      </form>
    </Modal>
  );
}
