import classes from "./HoldButton.module.css";
import { HoldRing } from "./HoldRing";
import { ARM_RING_MS, buttonWords, type Hold } from "./hold";
import type { HoldControl } from "./useHold";
import { useHoldInput } from "./useHoldInput";

const HINTS: Partial<Record<Hold["phase"], string>> = {
  idle: "1 s to arm, then keep holding. Letting go aborts.",
  ring: "Letting go now does nothing",
  holding: "Let go to abort",
  committed: "STOP still works",
  letting_go: "Aborting before the commit point",
};

/** Hold to throw: pointer, touch, or the space bar while it has the focus. */
export function HoldButton({ control, isEnabled }: { control: HoldControl; isEnabled: boolean }) {
  const { hold, press, release } = control;
  const input = useHoldInput({ press, release, isEnabled });
  const isBusy = hold.phase !== "idle";
  return (
    <button
      {...input}
      type="button"
      className={classes.hold}
      data-phase={hold.phase}
      data-testid="hold"
      aria-disabled={!isEnabled && !isBusy}
      aria-describedby="hold-hint"
      style={{ "--ring-ms": `${ARM_RING_MS}ms` } as React.CSSProperties}
    >
      <HoldRing phase={hold.phase} />
      <span className={classes.words}>
        <span className={classes.label} aria-live="assertive">
          {buttonWords(hold)}
        </span>
        <span className={classes.hint} id="hold-hint">
          {HINTS[hold.phase]}
        </span>
      </span>
      {!isBusy && <kbd className={classes.key}>Space</kbd>}
    </button>
  );
}
