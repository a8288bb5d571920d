import { Button } from "@mantine/core";
import type { Machine } from "../session/live";
import { useNow } from "../session/useNow";
import { useMay, useSession } from "../session/useSession";
import classes from "./LeaseControl.module.css";
import { leaseWords } from "./leaseWords";
import { isMoving } from "./phase";
import { TakeOver } from "./TakeOver";
import { useIsHolder, useLeaseActions } from "./useLease";

/** Who holds the machine, and the one thing to do about it; nothing is taken on a page that is not live. */
export function LeaseControl({ machine, isLive = true }: { machine: Machine; isLive?: boolean }) {
  const isHolder = useIsHolder(machine);
  const mayLease = useMay("lease");
  const mayTake = useMay("lease.take");
  const { acquire, release } = useLeaseActions(machine.machine_id);
  const now = useNow();
  const username = useSession()?.username ?? "";
  const isThrowing = isMoving(machine.lamp);
  const { holder } = machine.lease;
  return (
    <div className={classes.lease}>
      <span className={classes.words} data-testid="lease-words">
        {leaseWords(machine.lease, isHolder, now, username)}
      </span>
      {isHolder && (
        <Button
          variant="default"
          size="sm"
          loading={release.isPending}
          disabled={isThrowing}
          onClick={() => release.mutate()}
        >
          {isThrowing ? "Give back after the throw" : "Give back control"}
        </Button>
      )}
      {!holder && mayLease && (
        <Button
          variant="default"
          size="sm"
          loading={acquire.isPending}
          disabled={!isLive}
          onClick={() => acquire.mutate()}
        >
          Take control
        </Button>
      )}
      {holder && !isHolder && mayTake && <TakeOver machine={machine} />}
    </div>
  );
}
