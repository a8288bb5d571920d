/** Aim corrections of a machine, and what a person may do with them. */

import { useMutation, useQuery, useQueryClient } from "@tanstack/react-query";
import { api, type Schema, take } from "../session/client";

export type Aim = Schema["AimView"];
export type AimMode = Schema["AimModeView"];
export type AimVersion = Schema["AimVersionView"];
export type Proposal = Schema["AimProposal"];

const key = (machineId: string) => ["aim", machineId];

export function useAim(machineId: string) {
  return useQuery({
    queryKey: key(machineId),
    queryFn: () =>
      take(
        api.GET("/api/v1/machines/{machine_id}/aim", {
          params: { path: { machine_id: machineId } },
        }),
      ),
  });
}

export function useAimActions(machineId: string, mode: Schema["Mode"]) {
  const client = useQueryClient();
  const params = { path: { machine_id: machineId, mode } };
  const onSuccess = (aim: Aim) => client.setQueryData(key(machineId), aim);
  // What was refused has changed since it was shown.
  const onError = () => void client.invalidateQueries({ queryKey: key(machineId) });
  const apply = useMutation({
    mutationFn: (proposal_sha256: string) =>
      take(
        api.POST("/api/v1/machines/{machine_id}/aim/{mode}/apply", {
          params,
          body: { proposal_sha256 },
        }),
      ),
    onSuccess,
    onError,
  });
  const undo = useMutation({
    mutationFn: () => take(api.POST("/api/v1/machines/{machine_id}/aim/{mode}/undo", { params })),
    onSuccess,
    onError,
  });
  return { apply, undo };
}
