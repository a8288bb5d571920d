/** Machines that are added and retired. */

import { useMutation, useQuery, useQueryClient } from "@tanstack/react-query";
import { api, type Schema, take } from "../session/client";
import { FLEET } from "./useFleet";

/** While somebody stands at the machine and sets it up. */
const REFRESH_MS = 2000;

export type EnrolmentToken = Schema["EnrolmentToken"];
export type Enrolment = Schema["EnrolmentView"];

const of = (machine_id: string) => ({ params: { path: { machine_id } } });

export function useEnrolment(machineId: string) {
  return useQuery({
    queryKey: [FLEET, "enrolment", machineId],
    queryFn: async () =>
      (await take(api.GET("/api/v1/machines/{machine_id}/enrolment", of(machineId)))) ?? null,
    refetchInterval: ({ state }) =>
      state.data && state.data.stage !== "tested" && state.data.stage !== "expired"
        ? REFRESH_MS
        : false,
  });
}

export function useAddMachine() {
  const client = useQueryClient();
  return useMutation({
    mutationFn: (body: { name: string }) => take(api.POST("/api/v1/machines", { body })),
    onSuccess: () => client.invalidateQueries({ queryKey: [FLEET] }),
  });
}

export function useNewToken(machineId: string) {
  const client = useQueryClient();
  return useMutation({
    mutationFn: () => take(api.POST("/api/v1/machines/{machine_id}/enrolment", of(machineId))),
    onSuccess: () => client.invalidateQueries({ queryKey: [FLEET] }),
  });
}

/** The page of a retired machine is gone before the answer comes: what follows is a duty of the mutation. */
export function useRetire(machineId: string, onDone: () => void) {
  const client = useQueryClient();
  return useMutation({
    mutationFn: (reason: string) =>
      take(
        api.POST("/api/v1/machines/{machine_id}/retire", { ...of(machineId), body: { reason } }),
      ),
    onSuccess: () => {
      onDone();
      return client.invalidateQueries({ queryKey: [FLEET] });
    },
  });
}

export function useRetired() {
  return useQuery({
    queryKey: [FLEET, "retired"],
    queryFn: () => take(api.GET("/api/v1/fleet/retired")),
  });
}
