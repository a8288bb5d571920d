/** Drifts of a machine, and the diagnosis that one press starts. */

import { keepPreviousData, useMutation, useQuery, useQueryClient } from "@tanstack/react-query";
import { api, type Schema, take } from "../session/client";
import { GAP } from "./useGap";

/** `stamp` changes with what is known of the drifts: they are then read anew. */
export function useDrifts(machineId: string, stamp: string) {
  return useQuery({
    queryKey: [GAP, "drifts", machineId, stamp],
    placeholderData: keepPreviousData,
    queryFn: () =>
      take(
        api.GET("/api/v1/machines/{machine_id}/drifts", {
          params: { path: { machine_id: machineId } },
        }),
      ),
  });
}

export function useStartDriftRun(machineId: string, mode: Schema["Mode"]) {
  const client = useQueryClient();
  return useMutation({
    mutationFn: () =>
      take(
        api.POST("/api/v1/machines/{machine_id}/drifts/{mode}/gap-runs", {
          params: { path: { machine_id: machineId, mode } },
        }),
      ),
    onSettled: () => void client.invalidateQueries({ queryKey: [GAP] }),
  });
}
