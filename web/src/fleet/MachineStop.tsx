import { useStop } from "../machine/useStop";
import classes from "./Fleet.module.css";

/** STOP of one machine that stands beside others: it names the machine; one press, no dialog. */
export function MachineStop({ machineId }: { machineId: string }) {
  const { stop, status } = useStop(machineId);
  return (
    <span className={classes.stopCell}>
      <button
        type="button"
        className={classes.stop}
        data-testid={`stop-${machineId}`}
        onPointerDown={() => void stop()}
        onClick={() => void stop()}
      >
        STOP {machineId}
      </button>
      {status.text && (
        <span className={classes.failed} role={status.kind === "failed" ? "alert" : "status"}>
          {status.text}
        </span>
      )}
    </span>
  );
}
