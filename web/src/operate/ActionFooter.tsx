import { Button } from "@mantine/core";
import type { Machine } from "../session/live";
import { GateFooter } from "./GateFooter";
import type { Gate } from "./gate";
import { HoldButton } from "./hold/HoldButton";
import type { HoldControl } from "./hold/useHold";
import classes from "./Panel.module.css";

type Props = {
  machine: Machine;
  gate: Gate | null;
  control: HoldControl;
  hasResult: boolean;
  onAgain: () => void;
  onPreviewAgain: () => void;
  onOtherMode: () => void;
};

/** The foot of the panel: always the one thing to do next. */
export function ActionFooter(props: Props) {
  const { machine, gate, control, hasResult, onAgain, onPreviewAgain, onOtherMode } = props;
  const isBusy = control.hold.phase !== "idle";
  if (hasResult && !isBusy && !gate?.isAlarm) {
    return (
      <div className={classes.foot}>
        <Button fullWidth size="lg" onClick={onAgain}>
          Throw again
        </Button>
      </div>
    );
  }
  const isWaiting = gate?.id === "previewing";
  const showsButton = isBusy || !gate || isWaiting;
  return (
    <div className={classes.foot}>
      {gate && !isBusy && !isWaiting && (
        <GateFooter
          machineId={machine.machine_id}
          gate={gate}
          onPreviewAgain={onPreviewAgain}
          onOtherMode={onOtherMode}
        />
      )}
      {showsButton && <HoldButton control={control} isEnabled={gate === null} />}
      {control.hold.phase === "idle" && control.hold.note && (
        <p className={classes.refusal} role="alert" data-testid="hold-note">
          {control.hold.note}
        </p>
      )}
    </div>
  );
}
