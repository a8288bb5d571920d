/** Tells the server what this session's 3D view shows; the view itself is drawn there. */

import { useMutation } from "@tanstack/react-query";
import { useCallback, useEffect } from "react";
import { api, type Schema, take } from "../session/client";

type ViewRequest = Partial<Schema["ViewRequest"]>;
export type Camera = NonNullable<Schema["ViewRequest"]["camera"]>;

export function useViewRequest() {
  const { mutate } = useMutation({
    mutationFn: (wish: ViewRequest) =>
      take(api.PUT("/api/v1/view", { body: { play_preview: false, ...wish } })),
  });
  return useCallback((wish: ViewRequest) => mutate(wish), [mutate]);
}

/** Keeps the view on this machine and mode while the page shows it. */
export function useViewFollows(wish: {
  machineId: string | null;
  mode?: "2d" | "3d";
  isPicking: boolean;
  /** What a click is for: the target, or a point that the page asked for. */
  pickFor?: "target" | "point";
}): void {
  const { machineId, mode, isPicking, pickFor = "target" } = wish;
  const request = useViewRequest();
  useEffect(() => {
    if (machineId === null) return;
    request({ machine_id: machineId, mode, is_picking: isPicking, pick_for: pickFor });
  }, [request, machineId, mode, isPicking, pickFor]);
}
