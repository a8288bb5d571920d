import { useNow } from "../session/useNow";
import { clockTime, zoneName } from "../words/time";
import classes from "./TopBar.module.css";

/** Local time with its zone. */
export function Clock() {
  const date = new Date(useNow());
  return (
    <time className={classes.clock} dateTime={date.toISOString()}>
      <span className="visually-hidden">Local time </span>
      <span>{clockTime(date)}</span>
      <span className={classes.zone}>{zoneName(date)}</span>
    </time>
  );
}
