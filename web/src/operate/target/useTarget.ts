/** The proposed target of this session: shown at once, sent latest-first, confirmed by the server. */

import { useCallback, useEffect, useRef, useState } from "react";
import { api, take } from "../../session/client";
import { dispatchLive } from "../../session/liveStore";
import { errorWords } from "../../words/errors";
import type { Target } from "./target";

type Pending = { target: Target; mode: "2d" | "3d" };

export function useTarget(machineId: string | null) {
  const [error, setError] = useState<string | null>(null);
  const next = useRef<Pending | null>(null);
  const isSending = useRef(false);

  // biome-ignore lint/correctness/useExhaustiveDependencies: what was meant for another machine is dropped
  useEffect(() => {
    next.current = null;
    setError(null);
  }, [machineId]);

  const set = useCallback(
    async (target: Target, mode: "2d" | "3d") => {
      if (machineId === null) return;
      dispatchLive({ kind: "target", machineId, target, isProposing: true });
      next.current = { target, mode };
      if (isSending.current) return;
      isSending.current = true;
      while (next.current) {
        const pending: Pending = next.current;
        next.current = null;
        setError(await send(machineId, pending));
      }
      isSending.current = false;
      dispatchLive({ kind: "target_sent", machineId });
    },
    [machineId],
  );

  const clear = useCallback(async () => {
    if (machineId === null) return;
    dispatchLive({ kind: "target", machineId, target: null, isProposing: false });
    const params = { path: { machine_id: machineId } };
    await take(api.DELETE("/api/v1/machines/{machine_id}/target", { params })).catch(() => null);
  }, [machineId]);

  return { set, clear, error };
}

/** The error in words, or null when the server took the target. */
async function send(machineId: string, { target, mode }: Pending): Promise<string | null> {
  const { x_m, y_m, z_m } = target;
  const params = { path: { machine_id: machineId } };
  try {
    const body = { x_m, y_m, z_m, mode };
    await take(api.PUT("/api/v1/machines/{machine_id}/target", { params, body }));
    return null;
  } catch (error) {
    return errorWords(error);
  }
}
