/** A throw by its id, as events bring it; asked for too, so that it does not hang on an event that was missed. */

import { useQuery } from "@tanstack/react-query";
import { api, take } from "../session/client";
import type { Throw } from "../session/live";
import { useLive } from "../session/liveStore";

export function useThrow(throwId: string | null): Throw | null {
  const received = useLive((live) => (throwId === null ? null : (live.throws[throwId] ?? null)));
  const params = { path: { throw_id: throwId ?? "" } };
  // Asked anew with every reconnection of the events (useLiveConnection).
  const { data } = useQuery({
    queryKey: ["throw", throwId, "row"],
    queryFn: async () => (await take(api.GET("/api/v1/throws/{throw_id}", { params }))).row,
    enabled: throwId !== null && received?.phase !== "ended",
  });
  return newest(received, (throwId !== null && data) || null);
}

/** Phases only go forward: an end counts wherever it was read. */
export function newest(received: Throw | null, asked: Throw | null): Throw | null {
  if (received === null || asked === null) return received ?? asked;
  return received.phase !== "ended" && asked.phase === "ended" ? asked : received;
}
