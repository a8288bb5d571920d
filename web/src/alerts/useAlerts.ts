/** Open alerts as the server tells them, cleared ones in pages, and what a person may do with one. */

import { useInfiniteQuery, useMutation, useQueryClient } from "@tanstack/react-query";
import { useMemo } from "react";
import { api, take } from "../session/client";
import { dispatchLive, useLive } from "../session/liveStore";
import type { Alert, AlertSearch } from "./attention";

export const ALERTS = "alerts";
const PAGE_ROWS = 50;

export function useOpenAlerts(): readonly Alert[] {
  const open = useLive((live) => live.openAlerts);
  return useMemo(() => Object.values(open), [open]);
}

export function useClearedAlerts(search: AlertSearch, isEnabled = true) {
  const pages = useInfiniteQuery({
    queryKey: [ALERTS, "cleared", search.machine ?? null, search.rule ?? null],
    enabled: isEnabled,
    queryFn: ({ pageParam }) =>
      take(
        api.GET("/api/v1/alerts", {
          params: {
            query: {
              state: "cleared",
              machine_id: search.machine,
              rule: search.rule,
              cursor: pageParam ?? undefined,
              limit: PAGE_ROWS,
            },
          },
        }),
      ),
    initialPageParam: null as string | null,
    getNextPageParam: (page) => page.next_cursor,
  });
  return { ...pages, rows: pages.data?.pages.flatMap((page) => page.rows) ?? [] };
}

export function useAlertActions(alertId: string) {
  const client = useQueryClient();
  const params = { path: { alert_id: alertId } };
  const onSuccess = (alert: Alert) => {
    dispatchLive({ kind: "event", event: { kind: "alert.updated", alert }, sessionId: null });
    void client.invalidateQueries({ queryKey: [ALERTS] });
  };
  const acknowledge = useMutation({
    mutationFn: (note: string) =>
      take(api.POST("/api/v1/alerts/{alert_id}/acknowledge", { params, body: { note } })),
    onSuccess,
  });
  const silence = useMutation({
    mutationFn: (duration_s: number) =>
      take(api.POST("/api/v1/alerts/{alert_id}/silence", { params, body: { duration_s } })),
    onSuccess,
  });
  return { acknowledge, silence };
}
