import { NativeSelect, NumberInput, Textarea } from "@mantine/core";
import { useState } from "react";
import type { Schema } from "../session/client";
import { ConfirmDialog } from "./ConfirmDialog";
import { parseStages } from "./rolloutWords";
import { useRolloutActions } from "./useRollouts";

type Props = { policies: readonly Schema["PolicyView"][]; onClose: () => void };

/** Which version goes to which machines, in which stages. */
export function RolloutDialog({ policies, onClose }: Props) {
  const [sha256, setSha256] = useState(policies[0]?.policy_sha256 ?? "");
  const [stages, setStages] = useState("");
  const [throws, setThrows] = useState(12);
  const [minutes, setMinutes] = useState(10);
  const { start } = useRolloutActions();
  const chosen = policies.find((one) => one.policy_sha256 === sha256);
  const parsed = parseStages(stages);
  const confirm = (reason: string) => {
    if (!chosen) return;
    const body = {
      policy_sha256: sha256,
      reason,
      stages: parsed,
      throws_count: throws,
      deadline_s: minutes * 60,
    };
    start.mutate({ mode: chosen.mode, body }, { onSuccess: onClose });
  };
  return (
    <ConfirmDialog
      title="Start a rollout"
      action="Start the rollout"
      isPending={start.isPending}
      error={start.error}
      isBlocked={!chosen || parsed.length === 0}
      onConfirm={confirm}
      onClose={onClose}
    >
      <p>
        Machines of the first stage switch as soon as no plan is armed. A stage ends when each has
        thrown often enough and no worse than before. Worse throws take every machine back; a
        machine that does not answer pauses the rollout.
      </p>
      <NativeSelect
        label="Version"
        size="md"
        data-autofocus
        value={sha256}
        onChange={(event) => setSha256(event.currentTarget.value)}
        data={policies.map((one) => ({
          value: one.policy_sha256,
          label: `${one.policy_id} (${one.mode.toUpperCase()})`,
        }))}
      />
      <Textarea
        label="Stages"
        description="A line each: machines and tags, separated by commas, for example m001 or tag:yard"
        size="md"
        rows={3}
        required
        value={stages}
        onChange={(event) => setStages(event.currentTarget.value)}
      />
      <NumberInput
        label="Measured throws of each machine"
        size="md"
        min={4}
        max={200}
        allowDecimal={false}
        clampBehavior="strict"
        value={throws}
        onChange={(value) => setThrows(Number(value) || 12)}
      />
      <NumberInput
        label="Time for a machine to switch"
        size="md"
        suffix=" min"
        min={1}
        max={10_080}
        clampBehavior="strict"
        value={minutes}
        onChange={(value) => setMinutes(Number(value) || 10)}
      />
    </ConfirmDialog>
  );
}
