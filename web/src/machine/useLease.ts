/** Taking, keeping and giving back control of a machine. */

import { useMutation } from "@tanstack/react-query";
import { useEffect } from "react";
import { api, type Schema, take } from "../session/client";
import type { Machine } from "../session/live";
import { dispatchLive } from "../session/liveStore";
import { useSession } from "../session/useSession";

const RENEW_MS = 5000;

type Lease = Schema["LeaseView"];

/** The answer counts at once, without waiting for the broadcast. */
function applyLease(lease: Lease | undefined, cause: "acquired" | "released", by: string): void {
  if (!lease) return;
  dispatchLive({
    kind: "event",
    event: { kind: "lease.changed", lease, cause, by, reason: "" },
    sessionId: null,
  });
}

export function useIsHolder(machine: Machine | null): boolean {
  const session = useSession();
  return Boolean(session && machine?.lease.holder_session_id === session.session_id);
}

export function useLeaseActions(machineId: string) {
  const path = { path: { machine_id: machineId } };
  const by = useSession()?.username ?? "";
  const acquire = useMutation({
    mutationFn: () => take(api.POST("/api/v1/machines/{machine_id}/lease", { params: path })),
    onSuccess: (lease) => applyLease(lease, "acquired", by),
  });
  const release = useMutation({
    mutationFn: () => take(api.DELETE("/api/v1/machines/{machine_id}/lease", { params: path })),
    onSuccess: (lease) => applyLease(lease as Lease | undefined, "released", by),
  });
  const takeOver = useMutation({
    mutationFn: (reason: string) =>
      take(
        api.POST("/api/v1/machines/{machine_id}/lease/take", { params: path, body: { reason } }),
      ),
    onSuccess: (lease) => applyLease(lease, "acquired", by),
  });
  return { acquire, release, takeOver };
}

/** Renews the lease while it is ours and this page lives. */
export function useLeaseKeeper(machine: Machine | null): void {
  const isHolder = useIsHolder(machine);
  const machineId = machine?.machine_id ?? null;
  useEffect(() => {
    if (!isHolder || machineId === null) return;
    const renew = () => {
      const params = { path: { machine_id: machineId } };
      // A lost renewal is no error of its own: the lease runs out and the lamp says so.
      take(api.POST("/api/v1/machines/{machine_id}/lease", { params })).catch(() => undefined);
    };
    const timer = setInterval(renew, RENEW_MS);
    return () => clearInterval(timer);
  }, [isHolder, machineId]);
}
