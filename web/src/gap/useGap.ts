/** Diagnoses of a machine, its twin profile, and what may be done with them. */

import {
  keepPreviousData,
  useInfiniteQuery,
  useMutation,
  useQuery,
  useQueryClient,
} from "@tanstack/react-query";
import { api, type Schema, take } from "../session/client";
import type { GapRun } from "../session/live";
import { useLive } from "../session/liveStore";
import { toQuery } from "../throws/filters";
import { newest } from "./words";

export const GAP = "gap";
const PAGE_ROWS = 30;
const RECENT_THROWS = 60;

function useNewest(row: GapRun | undefined): GapRun | undefined {
  return useLive((live) => (row ? newest(row, live.gapRuns) : undefined));
}

export function useGapRuns(machineId: string | null) {
  const live = useLive((state) => state.gapRuns);
  const pages = useInfiniteQuery({
    queryKey: [GAP, "runs", machineId],
    enabled: machineId !== null,
    queryFn: ({ pageParam }) =>
      take(
        api.GET("/api/v1/machines/{machine_id}/gap-runs", {
          params: {
            path: { machine_id: machineId ?? "" },
            query: { cursor: pageParam ?? undefined, limit: PAGE_ROWS },
          },
        }),
      ),
    initialPageParam: null as string | null,
    getNextPageParam: (page) => page.next_cursor,
  });
  const rows = pages.data?.pages.flatMap((page) => page.rows) ?? [];
  return { ...pages, rows: rows.map((row) => newest(row, live)) };
}

export function useGapRun(machineId: string | null, runId: string | undefined) {
  const run = useQuery({
    queryKey: [GAP, "run", machineId, runId],
    enabled: machineId !== null && runId !== undefined,
    queryFn: () =>
      take(
        api.GET("/api/v1/machines/{machine_id}/gap-runs/{gap_run_id}", {
          params: { path: { machine_id: machineId ?? "", gap_run_id: runId ?? "" } },
        }),
      ),
  });
  return { ...run, row: useNewest(run.data?.row) };
}

/** Reference throws that commissioning has kept. */
export function useKeptReference(machineId: string) {
  return useQuery({
    queryKey: [GAP, "kept", machineId],
    queryFn: () =>
      take(
        api.GET("/api/v1/machines/{machine_id}/kept-reference", {
          params: { path: { machine_id: machineId } },
        }),
      ),
  });
}

export function useTwinProfile(machineId: string | null) {
  return useQuery({
    queryKey: [GAP, "twin", machineId],
    enabled: machineId !== null,
    queryFn: () =>
      take(
        api.GET("/api/v1/machines/{machine_id}/twin-profile", {
          params: { path: { machine_id: machineId ?? "" } },
        }),
      ),
  });
}

/** Throws that can be diagnosed or compared with: landed and with a log; the newest up to a local day. */
export function useThrowsToDiagnose(machineId: string, until?: string) {
  return useQuery({
    queryKey: ["throws", "to diagnose", machineId, until],
    placeholderData: keepPreviousData,
    queryFn: () =>
      take(
        api.GET("/api/v1/throws", {
          params: {
            query: {
              ...toQuery({ machine: machineId, outcome: "landed", until }),
              limit: RECENT_THROWS,
            },
          },
        }),
      ),
    select: (page) => page.rows.filter((row) => row.has_log),
  });
}

/** Start, cancel, apply and undo; each reads everything of the page anew. */
export function useGapActions(machineId: string) {
  const client = useQueryClient();
  // Not waited for: without a server the reading would take as long as the server is away.
  const onSettled = () => void client.invalidateQueries({ queryKey: [GAP] });
  const path = (gap_run_id: string) => ({
    params: { path: { machine_id: machineId, gap_run_id } },
  });
  const start = useMutation({
    mutationFn: (body: Schema["GapRunRequest"]) =>
      take(
        api.POST("/api/v1/machines/{machine_id}/gap-runs", {
          params: { path: { machine_id: machineId } },
          body,
        }),
      ),
    onSettled,
  });
  const cancel = useMutation({
    mutationFn: (runId: string) =>
      take(api.DELETE("/api/v1/machines/{machine_id}/gap-runs/{gap_run_id}", path(runId))),
    onSettled,
  });
  const apply = useMutation({
    mutationFn: (runId: string) =>
      take(api.POST("/api/v1/machines/{machine_id}/gap-runs/{gap_run_id}/apply", path(runId))),
    onSettled,
  });
  const undo = useMutation({
    mutationFn: () =>
      take(
        api.POST("/api/v1/machines/{machine_id}/twin-profile/undo", {
          params: { path: { machine_id: machineId } },
        }),
      ),
    onSettled,
  });
  return { start, cancel, apply, undo };
}

export type PreviewWish = { mode: "2d" | "3d"; range_m: number; azimuth_rad: number };

export function useGapPreview(machineId: string, runId: string) {
  return useMutation({
    mutationFn: (wish: PreviewWish) =>
      take(
        api.GET("/api/v1/machines/{machine_id}/gap-runs/{gap_run_id}/preview", {
          params: { path: { machine_id: machineId, gap_run_id: runId }, query: wish },
        }),
      ),
  });
}

export const reportHref = (machineId: string, runId: string) =>
  `/api/v1/machines/${encodeURIComponent(machineId)}/gap-runs/${encodeURIComponent(runId)}/report.html`;
