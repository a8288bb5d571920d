import { useState } from "react";
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
  onPreviewAgain: () => void;
  onOtherMode: () => void;
  onHeight: (z_m: number) => void;
};

/**
 * The foot of the panel: always the one thing to do next. Nothing that a lifted finger could press takes
 * the place of the hold button while it is down.
 */
export function ActionFooter(props: Props) {
  const { machine, gate, control, hasResult, onPreviewAgain, onOtherMode, onHeight } = props;
  const [isDown, setDown] = useState(false);
  const isBusy = control.hold.phase !== "idle" || isDown;
  if (hasResult && !isBusy && !gate?.isAlarm) {
    return (
      <div className={classes.foot}>
        <p className={classes.over} role="status">
          The throw is over. <em>Throw again</em> stands with the result; a new target begins anew.
        </p>
      </div>
    );
  }
  const isWaiting = gate?.id === "previewing";
  const showsButton = isBusy || !gate || isWaiting;
  return (
    <div className={classes.foot}>
      {gate && !isBusy && !isWaiting && (
        <GateFooter
          machine={machine}
          gate={gate}
          onPreviewAgain={onPreviewAgain}
          onOtherMode={onOtherMode}
          onHeight={onHeight}
        />
      )}
      {showsButton && (
        <HoldButton
          control={control}
          isEnabled={gate === null && !hasResult}
          reason={isWaiting ? gate.sentence : ""}
          onDown={setDown}
        />
      )}
      {!isBusy && control.hold.phase === "idle" && control.hold.note && (
        <p className={classes.refusal} role="alert" data-testid="hold-note">
          {control.hold.note}
        </p>
      )}
    </div>
  );
}
