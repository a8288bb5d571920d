import { Button, Group, NumberInput, TextInput } from "@mantine/core";
import { useMutation, useQueryClient } from "@tanstack/react-query";
import { useState } from "react";
import { api, take } from "../session/client";
import { errorWords } from "../words/errors";
import classes from "./MarkImpact.module.css";

/** Where the operator saw it come down: a new record, the earlier ones stay. */
export function MarkImpact({ throwId, onDone }: { throwId: string; onDone: () => void }) {
  const [along_m, setAlong] = useState<number | string>("");
  const [across_m, setAcross] = useState<number | string>("");
  const [note, setNote] = useState("");
  const client = useQueryClient();
  const mark = useMutation({
    mutationFn: (body: { downrange_error_m: number; crossrange_error_m: number; note: string }) =>
      take(
        api.POST("/api/v1/throws/{throw_id}/impacts", {
          params: { path: { throw_id: throwId } },
          body,
        }),
      ),
    onSuccess: async () => {
      await client.invalidateQueries({ queryKey: ["throw", throwId] });
      await client.invalidateQueries({ queryKey: ["throws"] });
      onDone();
    },
  });
  const isReady = typeof along_m === "number" && typeof across_m === "number";
  const submit = (event: React.FormEvent) => {
    event.preventDefault();
    if (isReady) mark.mutate({ downrange_error_m: along_m, crossrange_error_m: across_m, note });
  };
  const common = { decimalScale: 2, step: 0.05, min: -60, max: 60, required: true } as const;
  return (
    <form onSubmit={submit} className={classes.form} aria-label="Mark impact">
      <Group grow gap={8}>
        <NumberInput
          {...common}
          label="Long +, short −, m"
          value={along_m}
          onChange={setAlong}
          data-autofocus
        />
        <NumberInput {...common} label="Left +, right −, m" value={across_m} onChange={setAcross} />
      </Group>
      <TextInput
        mt={8}
        label="Note"
        placeholder="how it was measured"
        value={note}
        maxLength={500}
        onChange={(event) => setNote(event.currentTarget.value)}
      />
      {mark.isError && (
        <p className={classes.error} role="alert">
          {errorWords(mark.error)}
        </p>
      )}
      <Group mt={10} gap={8}>
        <Button type="submit" disabled={!isReady} loading={mark.isPending}>
          Save as a new record
        </Button>
        <Button variant="default" onClick={onDone}>
          Cancel
        </Button>
      </Group>
    </form>
  );
}
