/** Systems that are notified, and the messages to them; for admins. */

import { useInfiniteQuery, useMutation, useQuery, useQueryClient } from "@tanstack/react-query";
import { api, type Schema, take } from "../session/client";

const WEBHOOKS = "webhooks";
const PAGE_ROWS = 30;
/** While a message waits for its next attempt. */
const REFRESH_MS = 3000;

export type Webhook = Schema["WebhookView"];
export type Message = Schema["NotificationView"];
export type Topic = Webhook["topics"][number];

export function useWebhooks() {
  return useQuery({
    queryKey: [WEBHOOKS, "all"],
    queryFn: () => take(api.GET("/api/v1/webhooks")),
  });
}

export function useMessages() {
  const pages = useInfiniteQuery({
    queryKey: [WEBHOOKS, "messages"],
    queryFn: ({ pageParam }) =>
      take(
        api.GET("/api/v1/notifications", {
          params: { query: { cursor: pageParam ?? undefined, limit: PAGE_ROWS } },
        }),
      ),
    initialPageParam: null as string | null,
    getNextPageParam: (page) => page.next_cursor,
    refetchInterval: ({ state }) =>
      state.data?.pages.some((page) => page.rows.some((row) => row.next_utc !== null))
        ? REFRESH_MS
        : false,
  });
  return { ...pages, rows: pages.data?.pages.flatMap((page) => page.rows) ?? [] };
}

export function useWebhookActions() {
  const client = useQueryClient();
  const onSuccess = () => client.invalidateQueries({ queryKey: [WEBHOOKS] });
  const of = (webhook_id: string) => ({ params: { path: { webhook_id } } });
  const create = useMutation({
    mutationFn: (body: { url: string; topics: Topic[] }) =>
      take(api.POST("/api/v1/webhooks", { body })),
    onSuccess,
  });
  const remove = useMutation({
    mutationFn: (id: string) => take(api.DELETE("/api/v1/webhooks/{webhook_id}", of(id))),
    onSuccess,
  });
  const test = useMutation({
    mutationFn: (id: string) => take(api.POST("/api/v1/webhooks/{webhook_id}/test", of(id))),
    onSuccess,
  });
  const replay = useMutation({
    mutationFn: (notification_id: string) =>
      take(
        api.POST("/api/v1/notifications/{notification_id}/replay", {
          params: { path: { notification_id } },
        }),
      ),
    onSuccess,
  });
  return { create, remove, test, replay };
}
