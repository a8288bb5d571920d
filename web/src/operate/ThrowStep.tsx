import { phaseWord } from "../machine/phase";
import classes from "./Panel.module.css";
import { PhaseTimeline } from "./PhaseTimeline";
import { ThrowClock } from "./ThrowClock";
import type { Operate } from "./useOperate";

/** The throw while it runs: phases, and what letting go would do now. */
export function ThrowStep({ operate }: { operate: Operate }) {
  const { machine, plan, thrown, control } = operate;
  if (!machine) return null;
  const isOver = thrown?.phase === "ended";
  return (
    <>
      <PhaseTimeline machine={machine} plan={plan} isOver={isOver} />
      <ThrowClock machine={machine} plan={plan} />
      <p className={classes.note} role="status" data-testid="throw-words">
        {words(control.hold.phase, phaseWord(machine.lamp))}
      </p>
    </>
  );
}

function words(phase: Operate["control"]["hold"]["phase"], state: string): string {
  switch (phase) {
    case "holding":
      return `${state}. Letting go now aborts and brings the machine to rest.`;
    case "committed":
      return `${state}. The load is leaving; the machine completes the throw. STOP still works.`;
    case "letting_go":
      return `${state}. Aborting.`;
    case "idle":
      return `${state}.`;
    default:
      return "Hold for one second to arm, then keep holding.";
  }
}
