import { useEffect } from "react";
import { useMachine } from "../machine/useMachine";
import { useStop } from "../machine/useStop";
import classes from "./StopButton.module.css";

/** Shift+S, on every page; keys pressed in the 3D view arrive here as well (docs/viewer.md). */
function isStopKey(event: KeyboardEvent): boolean {
  return (
    event.shiftKey && event.code === "KeyS" && !event.ctrlKey && !event.metaKey && !event.altKey
  );
}

/** STOP of the machine that the console looks at: always at the same place, one press, no dialog. */
export function StopButton() {
  const machine = useMachine();
  const { stop, status } = useStop(machine?.machine_id ?? null);

  useEffect(() => {
    const onKey = (event: KeyboardEvent) => {
      if (!isStopKey(event) || event.repeat) return;
      event.preventDefault();
      event.stopPropagation();
      void stop();
    };
    document.addEventListener("keydown", onKey, { capture: true });
    return () => document.removeEventListener("keydown", onKey, { capture: true });
  }, [stop]);

  const isLatched = machine?.state?.stop_latched ?? false;
  const name = machine?.machine_id ?? "every machine";
  return (
    <div className={classes.wrap}>
      {status.kind === "failed" && (
        <span className={classes.failed} role="alert">
          {status.text}
        </span>
      )}
      <button
        type="button"
        className={classes.stop}
        data-latched={isLatched || undefined}
        data-testid="stop"
        aria-keyshortcuts="Shift+S"
        onPointerDown={() => void stop()}
        onClick={() => void stop()}
      >
        <span className={classes.word}>
          STOP <span className={classes.name}>{name}</span>
        </span>
        <kbd className={classes.key}>{isLatched ? "latched" : "Shift+S"}</kbd>
      </button>
    </div>
  );
}
