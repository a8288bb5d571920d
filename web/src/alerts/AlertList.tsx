import { AlertItem } from "./AlertItem";
import classes from "./Alerts.module.css";
import type { Alert } from "./attention";

/** Alerts below each other, as given. */
export function AlertList({ alerts, label }: { alerts: readonly Alert[]; label: string }) {
  return (
    <ul className={classes.list} aria-label={label}>
      {alerts.map((alert) => (
        <AlertItem key={alert.alert_id} alert={alert} />
      ))}
    </ul>
  );
}
