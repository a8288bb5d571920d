/** What the server knows of machines beside their live state, and how people call them. */

import { useMutation, useQuery, useQueryClient } from "@tanstack/react-query";
import { api, type Schema, take } from "../session/client";

export const FLEET = "fleet";

export type FleetRecord = Schema["FleetRowView"];
export type ModeSummary = Schema["ModeSummary"];
export type MissFigures = Schema["MissFigures"];
export type Commissioning = Schema["CommissioningView"];
export type MapMachine = Schema["MapMachineView"];
export type MachineLife = Schema["MachineLifeView"];

export function useFleet() {
  return useQuery({
    queryKey: [FLEET, "all"],
    queryFn: () => take(api.GET("/api/v1/fleet")),
  });
}

export function useMachineLife(machineId: string) {
  return useQuery({
    queryKey: [FLEET, "life", machineId],
    queryFn: () =>
      take(
        api.GET("/api/v1/machines/{machine_id}/life", {
          params: { path: { machine_id: machineId } },
        }),
      ),
  });
}

const MAP_PERIOD_MS = 30_000;

/** Machines with their places, objects, zones and last impacts. */
export function useYardMap() {
  return useQuery({
    queryKey: [FLEET, "map"],
    queryFn: () => take(api.GET("/api/v1/fleet/map")),
    // A place that somebody else changes comes with no event.
    refetchInterval: MAP_PERIOD_MS,
  });
}

/** Changes a machine's place in the yard. */
export function usePlace(machineId: string) {
  const client = useQueryClient();
  const params = { path: { machine_id: machineId } };
  const onSuccess = () => client.invalidateQueries({ queryKey: [FLEET, "map"] });
  const put = useMutation({
    mutationFn: (body: Schema["PlaceRequest"]) =>
      take(api.PUT("/api/v1/machines/{machine_id}/place", { params, body })),
    onSuccess,
  });
  const remove = useMutation({
    mutationFn: () => take(api.DELETE("/api/v1/machines/{machine_id}/place", { params })),
    onSuccess,
  });
  return { put, remove };
}

/** What commissioning has measured of a machine. */
export function useCommissioning(machineId: string) {
  return useQuery({
    queryKey: [FLEET, "commissioning", machineId],
    queryFn: () =>
      take(
        api.GET("/api/v1/machines/{machine_id}/commissioning", {
          params: { path: { machine_id: machineId } },
        }),
      ),
  });
}

export const commissioningReportHref = (machineId: string) =>
  `/api/v1/machines/${encodeURIComponent(machineId)}/commissioning/report.html`;

type Period = { since: string; until: string };

/** How much a dossier of a period would hold. */
export function useDossierExtent(machineId: string, period: Period | null) {
  return useQuery({
    queryKey: [FLEET, "dossier", machineId, period],
    queryFn: () =>
      take(
        api.GET("/api/v1/machines/{machine_id}/dossier/extent", {
          params: { path: { machine_id: machineId }, query: period ?? { since: "", until: "" } },
        }),
      ),
    enabled: period !== null,
  });
}

export const dossierHref = (machineId: string, period: Period) =>
  `/api/v1/machines/${encodeURIComponent(machineId)}/dossier?${new URLSearchParams(period)}`;

export function useEditMachine(machineId: string) {
  const client = useQueryClient();
  return useMutation({
    mutationFn: (body: { name: string; tags: string[] }) =>
      take(
        api.PATCH("/api/v1/machines/{machine_id}", {
          params: { path: { machine_id: machineId } },
          body,
        }),
      ),
    onSuccess: () => client.invalidateQueries({ queryKey: [FLEET] }),
  });
}
