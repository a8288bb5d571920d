/** What stands around a machine: read, changed, undone; news of others' changes come by event. */

import { useMutation, useQuery, useQueryClient } from "@tanstack/react-query";
import { api, type Schema, take } from "../session/client";
import { useLive } from "../session/liveStore";
import type { SiteObject } from "./objects";

const SITE = "site";

export function useSite(machineId: string) {
  const live = useLive((state) => state.sites[machineId]);
  const site = useQuery({
    queryKey: [SITE, machineId],
    queryFn: () =>
      take(
        api.GET("/api/v1/machines/{machine_id}/site", {
          params: { path: { machine_id: machineId } },
        }),
      ),
  });
  const isNewer = live && live.version_count > (site.data?.version_count ?? -1);
  return { ...site, data: isNewer ? live : site.data };
}

export function useSiteActions(machineId: string) {
  const client = useQueryClient();
  const params = { path: { machine_id: machineId } };
  const onSuccess = (site: Schema["SiteView"]) => client.setQueryData([SITE, machineId], site);
  const onError = () => void client.invalidateQueries({ queryKey: [SITE, machineId] });
  const save = useMutation({
    mutationFn: (wish: { objects: SiteObject[]; from_version_count: number }) =>
      take(api.PUT("/api/v1/machines/{machine_id}/site", { params, body: wish })),
    onSuccess,
    onError,
  });
  const undo = useMutation({
    mutationFn: () => take(api.POST("/api/v1/machines/{machine_id}/site/undo", { params })),
    onSuccess,
    onError,
  });
  return { save, undo };
}
