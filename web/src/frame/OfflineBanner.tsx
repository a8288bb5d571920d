import { staleSeconds, useConnection } from "../session/connection";
import { useNow } from "../session/useNow";
import { age } from "../words/format";
import classes from "./Banner.module.css";

/** A stream that opens again within this time is not worth a banner; the bar above says it at once. */
const SHOWN_FROM_S = 2;

/** Says that what is shown is not live, and since when. */
export function OfflineBanner() {
  const connection = useConnection();
  const stale_s = staleSeconds(connection, useNow());
  if (stale_s === null) return null;
  if (connection.refusal !== null) {
    return (
      <div className={classes.banner} role="alert" data-testid="offline">
        <span>
          <strong>Not live.</strong> {connection.refusal}
        </span>
      </div>
    );
  }
  if (connection.lastDataMs === null) {
    return (
      <div className={classes.banner} role="status">
        Connecting to the server
      </div>
    );
  }
  if (stale_s < SHOWN_FROM_S) return null;
  return (
    <div className={classes.banner} role="alert" data-testid="offline">
      <span>
        <strong>Not live: last data {age(stale_s)} ago.</strong> The console reconnects by itself. A
        throw before its commit point is aborted by the machine.
      </span>
    </div>
  );
}
