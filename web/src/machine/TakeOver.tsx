import { Button, Popover, Text, TextInput } from "@mantine/core";
import { useState } from "react";
import type { Machine } from "../session/live";
import { errorWords } from "../words/errors";
import { useLeaseActions } from "./useLease";

/** Taking control away from somebody: needs a reason, which they and the audit log see. */
export function TakeOver({ machine }: { machine: Machine }) {
  const [isOpen, setOpen] = useState(false);
  const [reason, setReason] = useState("");
  const { takeOver } = useLeaseActions(machine.machine_id);
  const submit = (event: React.FormEvent) => {
    event.preventDefault();
    takeOver.mutate(reason, { onSuccess: () => setOpen(false) });
  };
  return (
    <Popover opened={isOpen} onChange={setOpen} trapFocus width={320} position="bottom-end">
      <Popover.Target>
        <Button variant="default" size="sm" onClick={() => setOpen(!isOpen)}>
          Take over
        </Button>
      </Popover.Target>
      <Popover.Dropdown>
        <form onSubmit={submit}>
          <TextInput
            label={`Reason, shown to ${machine.lease.holder ?? "the holder"}`}
            value={reason}
            onChange={(event) => setReason(event.currentTarget.value)}
            minLength={3}
            maxLength={300}
            required
            data-autofocus
          />
          <Text size="xs" c="dimmed" mt={6}>
            The machine disarms. An abortable throw is aborted.
          </Text>
          {takeOver.isError && (
            <Text size="sm" c="var(--alarm-ink)" mt={6} role="alert">
              {errorWords(takeOver.error)}
            </Text>
          )}
          <Button
            type="submit"
            mt="sm"
            fullWidth
            loading={takeOver.isPending}
            disabled={reason.trim().length < 3}
          >
            Take over {machine.machine_id}
          </Button>
        </form>
      </Popover.Dropdown>
    </Popover>
  );
}
