import { useEffect, useRef, useState } from "react";
import classes from "./StopAllButton.module.css";
import { useStop } from "./useStop";

export const STOP_ALL_HOLD_MS = 1000;

/** Stops every machine of the server, after a hold of 1 s by pointer, Space or Enter. */
export function StopAllButton() {
  const { stop, status } = useStop(null);
  const [isHeld, setHeld] = useState(false);
  const sendStop = useRef(stop);
  sendStop.current = stop;
  useEffect(() => {
    if (!isHeld) return;
    const timer = setTimeout(() => {
      setHeld(false);
      void sendStop.current();
    }, STOP_ALL_HOLD_MS);
    return () => clearTimeout(timer);
  }, [isHeld]);

  const isKey = (event: React.KeyboardEvent) => event.key === " " || event.key === "Enter";
  const letGo = () => setHeld(false);
  return (
    <div className={classes.wrap}>
      <button
        type="button"
        className={classes.all}
        data-held={isHeld || undefined}
        data-testid="stop-all"
        style={{ "--hold-ms": `${STOP_ALL_HOLD_MS}ms` } as React.CSSProperties}
        onPointerDown={(event) => event.button === 0 && event.isPrimary && setHeld(true)}
        onPointerUp={letGo}
        onPointerLeave={letGo}
        onPointerCancel={letGo}
        onBlur={letGo}
        onContextMenu={(event) => event.preventDefault()}
        onKeyDown={(event) => {
          if (!isKey(event)) return;
          event.preventDefault();
          if (!event.repeat) setHeld(true);
        }}
        onKeyUp={(event) => isKey(event) && letGo()}
      >
        Stop every machine: hold for 1 s
      </button>
      <span className={classes.note} role="status">
        {status.kind === "sent"
          ? "STOP is sent to every machine."
          : status.text ||
            "STOP for every machine of this server, as the button at the top right for one."}
      </span>
    </div>
  );
}
