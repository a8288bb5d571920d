import type { Machine, Plan } from "../session/live";
import classes from "./PhaseTimeline.module.css";
import { PHASES, phaseIndex, phaseWidths } from "./phases";

/** Align, swing, release, flight, settle as one thin line; the release is the commit point. */
export function PhaseTimeline({
  machine,
  plan,
  isOver,
}: {
  machine: Machine | null;
  plan: Plan | null;
  isOver: boolean;
}) {
  const now = phaseIndex(machine, isOver);
  const widths = phaseWidths(plan);
  const word = PHASES[now];
  return (
    <ol className={classes.timeline} aria-label={`Phase: ${word ?? (isOver ? "over" : "waiting")}`}>
      {PHASES.map((name, index) => (
        <li
          key={name}
          className={classes.phase}
          style={{ flexGrow: widths[index] }}
          data-state={index < now ? "done" : index === now ? "now" : "next"}
          aria-current={index === now ? "step" : undefined}
        >
          {name}
        </li>
      ))}
    </ol>
  );
}
