/** Pages and statistics of the history for the filters in the address. */

import { keepPreviousData, useQuery } from "@tanstack/react-query";
import { api, take } from "../session/client";
import { type Filters, type GroupBy, toQuery } from "./filters";

export const PAGE_ROWS = 50;

export function useThrowPage(filters: Filters, cursor: string | undefined) {
  const query = { ...toQuery(filters), cursor, limit: PAGE_ROWS };
  return useQuery({
    queryKey: ["throws", "page", query],
    queryFn: () => take(api.GET("/api/v1/throws", { params: { query } })),
    placeholderData: keepPreviousData,
  });
}

export function useThrowStats(filters: Filters, groupBy: GroupBy) {
  const query = { ...toQuery(filters), group_by: groupBy };
  return useQuery({
    queryKey: ["throws", "stats", query],
    queryFn: () => take(api.GET("/api/v1/throws/stats", { params: { query } })),
    placeholderData: keepPreviousData,
  });
}

export function usePolicies() {
  return useQuery({
    queryKey: ["policies"],
    queryFn: () => take(api.GET("/api/v1/policies")),
    staleTime: 60_000,
  });
}
