import classes from "./HoldButton.module.css";
import type { Hold } from "./hold";

const RADIUS = 20;
const TURN = 2 * Math.PI * RADIUS;

/** Fills in one second, then stays full while the throw is held. */
export function HoldRing({ phase }: { phase: Hold["phase"] }) {
  return (
    <svg width="48" height="48" viewBox="0 0 48 48" aria-hidden="true" className={classes.ring}>
      <circle cx="24" cy="24" r={RADIUS} className={classes.track} />
      <circle
        cx="24"
        cy="24"
        r={RADIUS}
        className={classes.fill}
        data-phase={phase}
        strokeDasharray={TURN}
        style={{ "--turn": TURN } as React.CSSProperties}
        transform="rotate(-90 24 24)"
      />
      <circle cx="24" cy="24" r={phase === "idle" ? 7 : 10} className={classes.core} />
    </svg>
  );
}
