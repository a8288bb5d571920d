/** Rollouts of versions: the newest, and what a person may do with one. */

import { useMutation, useQuery, useQueryClient } from "@tanstack/react-query";
import { api, type Schema, take } from "../session/client";
import type { Mode } from "./usePolicyLife";

export type Rollout = Schema["RolloutView"];
export type RolloutMachine = Schema["RolloutMachineView"];
export type RolloutChange = "pause" | "resume" | "promote" | "abort";

const ROLLOUTS = "policy-rollouts";
const OPEN_MS = 5_000;
const QUIET_MS = 30_000;

export const isOpen = (one: Rollout) => one.state === "running" || one.state === "paused";

export function useRollouts() {
  return useQuery({
    queryKey: [ROLLOUTS],
    queryFn: () => take(api.GET("/api/v1/policy-rollouts")),
    refetchInterval: (query) => (query.state.data?.some(isOpen) ? OPEN_MS : QUIET_MS),
  });
}

export function useRolloutActions() {
  const client = useQueryClient();
  const onSettled = () => {
    for (const key of [ROLLOUTS, "deployments", "machine-policies"])
      void client.invalidateQueries({ queryKey: [key] });
  };
  const start = useMutation({
    mutationFn: ({ mode, body }: { mode: Mode; body: Schema["RolloutRequest"] }) =>
      take(api.POST("/api/v1/policy-rollouts/{mode}/start", { params: { path: { mode } }, body })),
    onSettled,
  });
  const change = useMutation({
    mutationFn: ({ id, change, reason }: { id: string; change: RolloutChange; reason: string }) =>
      take(
        api.POST("/api/v1/policy-rollouts/{rollout_id}/change/{change}", {
          params: { path: { rollout_id: id, change } },
          body: { reason },
        }),
      ),
    onSettled,
  });
  return { start, change };
}
