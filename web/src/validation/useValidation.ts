/** Validations of versions and the gates that they are checked against. */

import { useMutation, useQuery, useQueryClient } from "@tanstack/react-query";
import { useEffect, useRef } from "react";
import { api, type Schema, take } from "../session/client";

export type Validation = Schema["ValidationView"];
export type Gates = Schema["Gates"];
export type GateCheck = Schema["GateCheck"];
export type Mode = Schema["Mode"];

const VALIDATION = "policy-validation";
const GATES = "policy-gates";
const OPEN_MS = 1_000;
const QUIET_MS = 30_000;

export const isOpen = (one: Validation | null | undefined) =>
  one?.state === "queued" || one?.state === "running";

/** The newest validation of a version; asked again often while it is open. Its end changes the version's state. */
export function useValidation(policy_sha256: string) {
  const client = useQueryClient();
  const validation = useQuery({
    queryKey: [VALIDATION, policy_sha256],
    queryFn: async () =>
      (await take(
        api.GET("/api/v1/policies/{policy_sha256}/validation", {
          params: { path: { policy_sha256 } },
        }),
      )) ?? null,
    refetchInterval: (query) => (isOpen(query.state.data) ? OPEN_MS : QUIET_MS),
  });
  const open = isOpen(validation.data);
  const wasOpen = useRef(open);
  useEffect(() => {
    if (wasOpen.current && !open) void client.invalidateQueries({ queryKey: ["policies"] });
    wasOpen.current = open;
  }, [open, client]);
  return validation;
}

export function useValidationActions(policy_sha256: string) {
  const client = useQueryClient();
  const onSettled = () => {
    for (const key of [VALIDATION, "policies"]) void client.invalidateQueries({ queryKey: [key] });
  };
  const path = { params: { path: { policy_sha256 } } };
  const start = useMutation({
    mutationFn: (body: Schema["ValidationRequest"]) =>
      take(api.POST("/api/v1/policies/{policy_sha256}/validation", { ...path, body })),
    onSettled,
  });
  const cancel = useMutation({
    mutationFn: () => take(api.DELETE("/api/v1/policies/{policy_sha256}/validation", path)),
    onSettled,
  });
  return { start, cancel };
}

export function useGates() {
  return useQuery({
    queryKey: [GATES],
    queryFn: () => take(api.GET("/api/v1/policy-gates")),
  });
}

export function useSetGates(mode: Mode) {
  const client = useQueryClient();
  return useMutation({
    mutationFn: (body: Schema["GatesRequest"]) =>
      take(api.POST("/api/v1/policy-gates/{mode}", { params: { path: { mode } }, body })),
    onSettled: () => void client.invalidateQueries({ queryKey: [GATES] }),
  });
}

export const validationLogHref = (validationId: string, name: string) =>
  `/api/v1/policy-validations/${encodeURIComponent(validationId)}/logs/${encodeURIComponent(name)}`;
