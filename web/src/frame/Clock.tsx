import { useNow } from "../session/useNow";
import { clockTime, zoneName } from "../words/time";
import { useZone } from "../words/zone";
import classes from "./TopBar.module.css";

/** The time in the chosen zone. */
export function Clock() {
  const date = new Date(useNow());
  useZone();
  return (
    <time className={classes.clock} dateTime={date.toISOString()}>
      <span className="visually-hidden">Time </span>
      <span>{clockTime(date)}</span>
      <span className={classes.zone}>{zoneName(date)}</span>
    </time>
  );
}
