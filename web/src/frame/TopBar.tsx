import { Lamp } from "../machine/Lamp";
import { LeaseControl } from "../machine/LeaseControl";
import { LinkBadge } from "../machine/LinkBadge";
import { useMachine } from "../machine/useMachine";
import { staleSeconds, useConnection } from "../session/connection";
import { useNow } from "../session/useNow";
import { Clock } from "./Clock";
import { MachinePicker } from "./MachinePicker";
import { PersonMenu } from "./PersonMenu";
import { StopButton } from "./StopButton";
import classes from "./TopBar.module.css";

/** The same on every page; STOP is its last element. */
export function TopBar() {
  const machine = useMachine();
  const isLive = staleSeconds(useConnection(), useNow()) === null;
  return (
    <header className={classes.bar}>
      <MachinePicker />
      {machine && <Lamp machine={machine} isLive={isLive} />}
      {machine && <LeaseControl machine={machine} isLive={isLive} />}
      <div className={classes.space} />
      {machine && <LinkBadge machine={machine} isLive={isLive} />}
      <Clock />
      <PersonMenu />
      <StopButton />
    </header>
  );
}
