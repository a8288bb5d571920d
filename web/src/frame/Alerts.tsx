import { CloseButton } from "@mantine/core";
import { dispatchLive, useLive } from "../session/liveStore";
import classes from "./Banner.module.css";

const SHOWN = 2;

/** The newest alerts from the server, until dismissed. */
export function Alerts() {
  const alerts = useLive((live) => live.alerts);
  return alerts.slice(-SHOWN).map((alert) => (
    <div key={alert.id} className={classes.banner} data-severity={alert.severity} role="alert">
      <span className={classes.text}>
        {alert.machine_id && !alert.text.includes(alert.machine_id) && (
          <strong>{alert.machine_id}: </strong>
        )}
        {alert.text}
      </span>
      <CloseButton
        aria-label="Dismiss"
        size="md"
        onClick={() => dispatchLive({ kind: "dismiss", id: alert.id })}
      />
    </div>
  ));
}
