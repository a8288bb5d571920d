/** Exclusion zones of a machine: read, changed, undone, approved; news of others' changes come by event. */

import { useMutation, useQuery, useQueryClient } from "@tanstack/react-query";
import { api, take } from "../session/client";
import { useLive } from "../session/liveStore";
import type { Zone, Zones } from "./zones";

const ZONES = "zones";

export function useZones(machineId: string) {
  const live = useLive((state) => state.zones[machineId]);
  const zones = useQuery({
    queryKey: [ZONES, machineId],
    queryFn: () =>
      take(
        api.GET("/api/v1/machines/{machine_id}/zones", {
          params: { path: { machine_id: machineId } },
        }),
      ),
  });
  const data = zones.data;
  const isNewer =
    live &&
    (!data ||
      live.version_count > data.version_count ||
      (live.version_count === data.version_count &&
        live.approved_version_count > data.approved_version_count));
  return { ...zones, data: isNewer ? live : data };
}

export function useZoneActions(machineId: string) {
  const client = useQueryClient();
  const params = { path: { machine_id: machineId } };
  const onSuccess = (zones: Zones) => client.setQueryData([ZONES, machineId], zones);
  const onError = () => void client.invalidateQueries({ queryKey: [ZONES, machineId] });
  const save = useMutation({
    mutationFn: (wish: { zones: Zone[]; from_version_count: number; reason: string }) =>
      take(api.PUT("/api/v1/machines/{machine_id}/zones", { params, body: wish })),
    onSuccess,
    onError,
  });
  const undo = useMutation({
    mutationFn: () => take(api.POST("/api/v1/machines/{machine_id}/zones/undo", { params })),
    onSuccess,
    onError,
  });
  const approve = useMutation({
    mutationFn: (version_count: number) =>
      take(
        api.POST("/api/v1/machines/{machine_id}/zones/approve", {
          params,
          body: { version_count },
        }),
      ),
    onSuccess,
    onError,
  });
  return { save, undo, approve };
}
