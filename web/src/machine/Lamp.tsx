import type { Machine } from "../session/live";
import { useNow } from "../session/useNow";
import classes from "./Lamp.module.css";
import { LampMark } from "./LampMark";
import { lampWords, phaseTone } from "./phase";

/** The state lamp: shape, colour and words. */
export function Lamp({ machine, isLive = true }: { machine: Machine; isLive?: boolean }) {
  const now = useNow();
  const words = lampWords(machine, now);
  return (
    <div
      className={classes.lamp}
      data-tone={phaseTone(machine.lamp)}
      data-stale={!isLive || undefined}
      role="status"
      aria-label={`Machine state: ${words}${isLive ? "" : ", not live"}`}
      data-testid="lamp"
      data-phase={machine.lamp}
    >
      <LampMark phase={machine.lamp} />
      <span className={classes.words}>{words}</span>
      {machine.is_stop_pending && <span className={classes.words}>· STOP pending</span>}
    </div>
  );
}
