import classes from "./HoldButton.module.css";
import { HoldRing } from "./HoldRing";
import { ARM_RING_MS, buttonWords, type Hold } from "./hold";
import type { HoldControl } from "./useHold";
import { useHoldInput } from "./useHoldInput";

const HINTS: Partial<Record<Hold["phase"], string>> = {
  idle: "1 s to arm, then keep holding. Letting go aborts.",
  ring: "Let go now and nothing moves",
  holding: "Let go to abort",
  committed: "STOP still works",
  letting_go: "Aborting before the commit point",
};

type Props = {
  control: HoldControl;
  isEnabled: boolean;
  /** Why it cannot be held; empty while it can. */
  reason?: string;
  /** Whether a finger, mouse button or key is still down on it. */
  onDown?: (isDown: boolean) => void;
};

const NOBODY = () => undefined;

/** Hold to throw: pointer, touch, or the space bar while it has the focus. */
export function HoldButton({ control, isEnabled, reason = "", onDown = NOBODY }: Props) {
  const { hold, press, release } = control;
  const { handlers, isDown } = useHoldInput({ press, release, isEnabled, onDown });
  const isBusy = hold.phase !== "idle";
  const isSpent = isDown && !isBusy;
  const isOff = isSpent || (!isEnabled && !isBusy);
  const note = hold.phase === "idle" ? hold.note : null;
  const hint = isSpent
    ? (note ?? "It does nothing until then")
    : (!isBusy && reason) || HINTS[hold.phase];
  return (
    <button
      {...handlers}
      type="button"
      className={classes.hold}
      data-phase={hold.phase}
      data-note={(isSpent && note !== null) || undefined}
      data-testid="hold"
      aria-disabled={isOff}
      aria-describedby="hold-hint"
      style={{ "--ring-ms": `${ARM_RING_MS}ms` } as React.CSSProperties}
    >
      <HoldRing phase={hold.phase} />
      <span className={classes.words}>
        <span className={classes.label} aria-live="assertive">
          {isSpent ? "Over: lift the finger" : buttonWords(hold)}
        </span>
        <span className={classes.hint} id="hold-hint">
          {hint}
        </span>
      </span>
      {!isBusy && <kbd className={classes.key}>Space</kbd>}
    </button>
  );
}
