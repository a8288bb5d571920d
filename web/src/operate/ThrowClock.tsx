import { useEffect, useState } from "react";
import { isMoving } from "../machine/phase";
import type { Machine, Plan } from "../session/live";
import { useNow } from "../session/useNow";
import { seconds, speed } from "../words/format";
import classes from "./Panel.module.css";
import { toCommit_s } from "./throwTimes";

const RENEW_MS = 100;

/** While the machine moves: elapsed time, time to the commit point, and the speed of the release. */
export function ThrowClock({ machine, plan }: { machine: Machine; plan: Plan | null }) {
  const now = useNow(RENEW_MS);
  const isRunning = isMoving(machine.lamp);
  const [startMs, setStart] = useState<number | null>(null);
  useEffect(() => setStart(isRunning ? Date.now() : null), [isRunning]);
  if (!isRunning || startMs === null) return null;
  const elapsed_s = Math.max(0, (now - startMs) / 1000);
  const left_s = toCommit_s(machine.lamp, plan, elapsed_s);
  return (
    <dl className={classes.numbers} data-testid="throw-clock">
      <dt>Elapsed</dt>
      <dd>{seconds(elapsed_s, 1)}</dd>
      <dt>To the commit point, predicted</dt>
      <dd>{left_s === null ? "passed" : seconds(left_s, 1)}</dd>
      <dt>Release speed, predicted</dt>
      <dd>{speed(plan?.prediction?.release_speed_m_per_s)}</dd>
    </dl>
  );
}
