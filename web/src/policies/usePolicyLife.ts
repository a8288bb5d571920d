/** What machines have on board, what they are to have, and what the site has approved. */

import { useMutation, useQuery, useQueryClient } from "@tanstack/react-query";
import { api, type Schema, take } from "../session/client";

export type Mode = Schema["Mode"];
export type OnBoard = Schema["MachinePolicyView"];
export type Deployment = Schema["DeploymentView"];
export type Approval = Schema["Approval"];
export type SiteKey = Schema["SiteKeyView"];
export type PolicyState = Schema["PolicyState"];

const ON_BOARD = "machine-policies";
const DEPLOYMENTS = "deployments";
const APPROVALS = "policy-approvals";
const APPROVAL_BASIS = "policy-approval-basis";
const HISTORY = "policy-history";
const POLICIES = "policies";
const KEYS = "policy-keys";
const WAITING_MS = 2_000;
const QUIET_MS = 15_000;

/** What a machine had on board at a time (ISO), or has now; asked again often while it is to switch. */
export function useOnBoard(machineId: string, at: string | null, isWaiting = false) {
  return useQuery({
    queryKey: [ON_BOARD, machineId, at],
    queryFn: () =>
      take(
        api.GET("/api/v1/machines/{machine_id}/policies", {
          params: { path: { machine_id: machineId }, query: at === null ? {} : { at } },
        }),
      ),
    refetchInterval: at === null && (isWaiting ? WAITING_MS : QUIET_MS),
  });
}

export function useDeployments(machineId: string) {
  return useQuery({
    queryKey: [DEPLOYMENTS, machineId],
    queryFn: () =>
      take(
        api.GET("/api/v1/machines/{machine_id}/deployments", {
          params: { path: { machine_id: machineId } },
        }),
      ),
    refetchInterval: (query) =>
      query.state.data?.some((one) => one.outcome === "pending") ? WAITING_MS : QUIET_MS,
  });
}

export function useApprovals() {
  return useQuery({
    queryKey: [APPROVALS],
    queryFn: () => take(api.GET("/api/v1/policy-approvals")),
  });
}

/** The site's keys, the newest first; machines say now and then which they trust. */
export function useSiteKeys() {
  return useQuery({
    queryKey: [KEYS],
    queryFn: () => take(api.GET("/api/v1/policy-keys")),
    refetchInterval: QUIET_MS,
  });
}

/** The steps of a version's life, oldest first. */
export function usePolicyHistory(sha256: string) {
  return useQuery({
    queryKey: [HISTORY, sha256],
    queryFn: () =>
      take(
        api.GET("/api/v1/policies/{policy_sha256}/history", {
          params: { path: { policy_sha256: sha256 } },
        }),
      ),
  });
}

/** Whether the newest validation of a version passed the gates in force. */
export function useApprovalBasis(sha256: string) {
  return useQuery({
    queryKey: [APPROVAL_BASIS, sha256],
    queryFn: () =>
      take(
        api.GET("/api/v1/policies/{policy_sha256}/approval-basis", {
          params: { path: { policy_sha256: sha256 } },
        }),
      ),
    staleTime: 0,
  });
}

type Step = { sha256: string; reason: string };

/** Each change is asked for once; what became of it is read from the server. */
export function usePolicyActions(machineId: string) {
  const client = useQueryClient();
  const onSettled = () => {
    for (const key of [ON_BOARD, DEPLOYMENTS, APPROVALS, HISTORY, POLICIES])
      void client.invalidateQueries({ queryKey: [key] });
  };
  const deploy = useMutation({
    mutationFn: (wish: { mode: Mode; policy_sha256: string; reason: string }) =>
      take(
        api.POST("/api/v1/machines/{machine_id}/policies/{mode}/deploy", {
          params: { path: { machine_id: machineId, mode: wish.mode } },
          body: { policy_sha256: wish.policy_sha256, reason: wish.reason },
        }),
      ),
    onSettled,
  });
  const rollBack = useMutation({
    mutationFn: (wish: { mode: Mode; reason: string }) =>
      take(
        api.POST("/api/v1/machines/{machine_id}/policies/{mode}/rollback", {
          params: { path: { machine_id: machineId, mode: wish.mode } },
          body: { reason: wish.reason },
        }),
      ),
    onSettled,
  });
  const approve = useMutation({
    mutationFn: ({
      sha256,
      reason,
      isWithoutValidation,
    }: Step & { isWithoutValidation: boolean }) =>
      take(
        api.POST("/api/v1/policies/{policy_sha256}/approve", {
          params: { path: { policy_sha256: sha256 } },
          body: { reason, is_without_validation: isWithoutValidation },
        }),
      ),
    onSettled,
  });
  const withdraw = useMutation({
    mutationFn: ({ sha256, reason }: Step) =>
      take(
        api.POST("/api/v1/policies/{policy_sha256}/withdraw", {
          params: { path: { policy_sha256: sha256 } },
          body: { reason },
        }),
      ),
    onSettled,
  });
  const retire = useMutation({
    mutationFn: ({ sha256, reason }: Step) =>
      take(
        api.POST("/api/v1/policies/{policy_sha256}/retire", {
          params: { path: { policy_sha256: sha256 } },
          body: { reason },
        }),
      ),
    onSettled,
  });
  return { deploy, rollBack, approve, withdraw, retire };
}
