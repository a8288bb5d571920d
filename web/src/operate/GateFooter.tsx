import { Button } from "@mantine/core";
import { useMutation } from "@tanstack/react-query";
import { useNavigate } from "@tanstack/react-router";
import { useState } from "react";
import { useLeaseActions } from "../machine/useLease";
import { api, take } from "../session/client";
import type { Machine } from "../session/live";
import { errorWords } from "../words/errors";
import { signed } from "../words/format";
import { ClearStop } from "./ClearStop";
import type { Gate, GateAction } from "./gate";
import classes from "./Panel.module.css";

const LABELS: Record<NonNullable<GateAction>, string> = {
  take_control: "Take control",
  load: "Load",
  clear_stop: "Clear STOP",
  disarm: "Disarm",
  preview_again: "Preview again",
  other_mode: "Switch mode",
  open_policies: "Open Policies",
  use_surface: "Use",
};

/** "top, +1.20 m", "floor, −0.80 m", "ground, 0.00 m". */
function surfaceWords(z_m: number): string {
  const word = z_m > 0 ? "top" : z_m < 0 ? "floor" : "ground";
  return `${word}, ${signed(z_m)} m`;
}

type Props = {
  machine: Machine;
  gate: Gate;
  onPreviewAgain: () => void;
  onOtherMode: () => void;
  onHeight: (z_m: number) => void;
};

/** What stands in the way, and the one thing to do about it. */
export function GateFooter({ machine, gate, onPreviewAgain, onOtherMode, onHeight }: Props) {
  const navigate = useNavigate();
  const [isClearing, setClearing] = useState(false);
  const { acquire } = useLeaseActions(machine.machine_id);
  const params = { path: { machine_id: machine.machine_id } };
  const command = useMutation({
    mutationFn: (what: "load" | "disarm") =>
      take(api.POST(`/api/v1/machines/{machine_id}/${what}` as const, { params })),
  });
  const run: Record<NonNullable<GateAction>, () => void> = {
    take_control: () => acquire.mutate(),
    load: () => command.mutate("load"),
    clear_stop: () => setClearing(true),
    disarm: () => command.mutate("disarm"),
    preview_again: onPreviewAgain,
    other_mode: onOtherMode,
    open_policies: () => void navigate({ to: "/policies" }),
    use_surface: () => onHeight(gate.surface_m ?? 0),
  };
  const error = command.error ?? acquire.error;
  return (
    <div data-testid="gate" data-gate={gate.id}>
      <p className={classes.gate} data-alarm={gate.isAlarm || undefined} role="status">
        {gate.sentence}
      </p>
      {gate.action && (
        <Button
          fullWidth
          size="md"
          loading={command.isPending || acquire.isPending}
          onClick={run[gate.action]}
        >
          {LABELS[gate.action]}
          {gate.action === "use_surface" && ` ${surfaceWords(gate.surface_m ?? 0)}`}
        </Button>
      )}
      {isClearing && gate.action === "clear_stop" && (
        <ClearStop machine={machine} onClose={() => setClearing(false)} />
      )}
      {error && (
        <p className={classes.refusal} role="alert">
          {errorWords(error)}
        </p>
      )}
    </div>
  );
}
