/** Jobs of a machine, one job, its surface, and what may be done with it. */

import {
  keepPreviousData,
  useInfiniteQuery,
  useMutation,
  useQuery,
  useQueryClient,
} from "@tanstack/react-query";
import { api, type Schema, take } from "../session/client";
import type { Job, JobFile } from "./job";
import type { Survey } from "./survey";

export const JOBS = "jobs";
const PAGE_ROWS = 30;
const RECENT_THROWS = 20;

export function useJobs(machineId: string) {
  const pages = useInfiniteQuery({
    queryKey: [JOBS, "list", machineId],
    queryFn: ({ pageParam }) =>
      take(
        api.GET("/api/v1/jobs", {
          params: {
            query: { machine_id: machineId, cursor: pageParam ?? undefined, limit: PAGE_ROWS },
          },
        }),
      ),
    initialPageParam: null as string | null,
    getNextPageParam: (page) => page.next_cursor,
  });
  return { ...pages, items: pages.data?.pages.flatMap((page) => page.items) ?? [] };
}

/** The open job of a machine, if it has one. */
export function useOpenJob(machineId: string) {
  return useQuery({
    queryKey: [JOBS, "open", machineId],
    queryFn: () =>
      take(
        api.GET("/api/v1/jobs", {
          params: { query: { machine_id: machineId, status: "open", limit: 1 } },
        }),
      ),
    select: (page) => page.items[0] ?? null,
  });
}

export function useJob(jobId: string) {
  return useQuery({
    queryKey: [JOBS, "one", jobId],
    queryFn: () => take(api.GET("/api/v1/jobs/{job_id}", { params: { path: { job_id: jobId } } })),
    // A load may have been thrown since the page was last open.
    refetchOnMount: "always",
  });
}

/** The surface after a change; the one before is shown until it is there. */
export function useSurface(job: Job) {
  return useQuery({
    // Apart from the jobs: a plan that is ready changes a job, not its surface.
    queryKey: ["job-surface", job.job_id, job.version_count],
    queryFn: () =>
      take(api.GET("/api/v1/jobs/{job_id}/surface", { params: { path: { job_id: job.job_id } } })),
    placeholderData: keepPreviousData,
    staleTime: Number.POSITIVE_INFINITY,
  });
}

/** Throws of a machine that landed lately: what can be recorded as a load. */
export function useLandedThrows(machineId: string) {
  return useQuery({
    queryKey: ["throws", "to record", machineId],
    queryFn: () =>
      take(
        api.GET("/api/v1/throws", {
          params: {
            query: { machine_id: machineId, outcome: "landed", limit: RECENT_THROWS },
          },
        }),
      ),
  });
}

export type NewJob = {
  machine_id: string;
  file: JobFile;
  survey: () => Promise<Survey | null>;
};

export function useStartJob() {
  const client = useQueryClient();
  return useMutation({
    mutationFn: async ({ survey, ...job }: NewJob) =>
      take(api.POST("/api/v1/jobs", { body: { ...job, ...(await survey()) } })),
    onSuccess: (job) => client.setQueryData([JOBS, "one", job.job_id], job),
    onSettled: () => void client.invalidateQueries({ queryKey: [JOBS] }),
  });
}

/** What a person does with an open job. Each names the state that it was decided on. */
export type JobChange =
  | { kind: "skip"; body: Omit<Schema["JobSkipRequest"], "version_count"> }
  | { kind: "move"; body: Omit<Schema["JobMoveRequest"], "version_count"> }
  | { kind: "loads"; body: Omit<Schema["JobLoadRequest"], "version_count"> }
  | { kind: "undo"; body: object }
  | { kind: "survey"; body: Survey }
  | { kind: "end"; body: { reason: string } };

export function useJobChange(job: Job) {
  const client = useQueryClient();
  return useMutation({
    mutationFn: ({ kind, body }: JobChange) =>
      take(
        api.POST(`/api/v1/jobs/{job_id}/${kind}` as const, {
          params: { path: { job_id: job.job_id } },
          body: { version_count: job.version_count, ...body } as never,
        }),
      ),
    onSuccess: (next) => client.setQueryData([JOBS, "one", job.job_id], next),
    onSettled: () => void client.invalidateQueries({ queryKey: [JOBS] }),
  });
}

export const reportHref = (jobId: string) => `/api/v1/jobs/${encodeURIComponent(jobId)}/report`;
