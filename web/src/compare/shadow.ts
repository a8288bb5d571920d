/** What another version would have done in recorded throws. */

import { useMutation, useQuery, useQueryClient } from "@tanstack/react-query";
import { api, type Schema, take } from "../session/client";
import { crossrangeWords, downrangeWords, fixed, signed } from "../words/format";
import { localStamp } from "../words/time";

export type Shadow = Schema["ShadowReport"];
export type ShadowThrow = Shadow["throws"][number];
export type ShadowRun = Schema["ShadowRunSummary"];
export type Miss = { downrange_m: number; crossrange_m: number };

const RUNS = "policy-shadows";

export function useShadow() {
  const client = useQueryClient();
  return useMutation({
    mutationFn: ({ sha256, ...body }: Schema["ShadowRequest"] & { sha256: string }) =>
      take(
        api.POST("/api/v1/policies/{policy_sha256}/shadow", {
          params: { path: { policy_sha256: sha256 } },
          body,
        }),
      ),
    onSuccess: (run) => {
      client.setQueryData([RUNS, "one", run.shadow_id], run);
      void client.invalidateQueries({ queryKey: [RUNS, "of", run.policy_sha256] });
    },
  });
}

/** What was run of a version, newest first. */
export function useShadows(sha256: string | null) {
  return useQuery({
    queryKey: [RUNS, "of", sha256],
    enabled: sha256 !== null,
    queryFn: () =>
      take(
        api.GET("/api/v1/policies/{policy_sha256}/shadows", {
          params: { path: { policy_sha256: sha256 ?? "" } },
        }),
      ),
  });
}

/** A run with its throws; it never changes. */
export function useShadowRun(shadowId: string | null) {
  return useQuery({
    queryKey: [RUNS, "one", shadowId],
    enabled: shadowId !== null,
    staleTime: Number.POSITIVE_INFINITY,
    queryFn: () =>
      take(
        api.GET("/api/v1/policy-shadows/{shadow_id}", {
          params: { path: { shadow_id: shadowId ?? "" } },
        }),
      ),
  });
}

/** The mean predicted miss of a run: "+0.02, −0.01 (11 of 12)". */
export function figureWords(misses: ShadowRun["figures"]["flown"]): string {
  if (misses.throw_count === 0) return "files gone";
  const share = `(${misses.landed_count} of ${misses.throw_count})`;
  const { mean_downrange_m: down, mean_crossrange_m: cross } = misses;
  return down === null || cross === null
    ? `none lands ${share}`
    : `${signed(down)}, ${signed(cross)} ${share}`;
}

/** Which throws a run was asked to take: "m001, since 2026-11-21 14:03:21". */
export function throwsWords(run: ShadowRun): string {
  const part = (word: string, iso: string | null) => (iso ? [`${word} ${localStamp(iso)}`] : []);
  return [
    run.machine_id ?? "all machines",
    ...part("since", run.since_utc),
    ...part("until", run.until_utc),
  ].join(", ");
}

/** Where a throw comes down beside its target; null where it does not land. */
export function missOf(
  one: {
    downrange_error_m?: number | null;
    crossrange_error_m?: number | null;
  } | null,
): Miss | null {
  const [down, cross] = [one?.downrange_error_m, one?.crossrange_error_m];
  return typeof down === "number" && typeof cross === "number"
    ? { downrange_m: down, crossrange_m: cross }
    : null;
}

export const measuredOf = (one: ShadowThrow) =>
  missOf({
    downrange_error_m: one.measured_downrange_error_m,
    crossrange_error_m: one.measured_crossrange_error_m,
  });

/** "+0.02, −0.01", or why there is none. */
export function missWords(one: ShadowThrow["candidate"] | null): string {
  if (one === null) return "files gone";
  return pairWords(missOf(one), one.outcome.replace("_", " "));
}

/** "+0.02, −0.01", or the words for none. */
export const pairWords = (miss: Miss | null, none: string) =>
  miss === null ? none : `${signed(miss.downrange_m)}, ${signed(miss.crossrange_m)}`;

/** When it would have let go in the same situation: "0.08 s sooner"; the network is asked every 0.08 s. */
export function letGoWords({ flown_release_s, shown_release_s }: ShadowThrow): string {
  if (flown_release_s === null) return "no release";
  if (shown_release_s === null) return "later";
  const sooner_s = flown_release_s - shown_release_s;
  return sooner_s < 0.005 ? "same" : `${fixed(sooner_s)} s sooner`;
}

/** The mean misses in one sentence. */
export function summaryWords(found: Shadow): string {
  const part = (name: string, misses: (Miss | null)[]) => {
    const landed = misses.filter((miss) => miss !== null);
    if (landed.length === 0) return `${name} never lands in the twin`;
    const mean = (pick: (miss: Miss) => number) =>
      landed.reduce((sum, miss) => sum + pick(miss), 0) / landed.length;
    const where = `${downrangeWords(mean((m) => m.downrange_m))}, ${crossrangeWords(mean((m) => m.crossrange_m))}`;
    return `${name} lands ${landed.length} of ${misses.length} times, on average ${where}`;
  };
  const own = part(
    found.policy_id,
    found.throws.map((one) => missOf(one.candidate)),
  );
  const flown = found.throws.filter((one) => one.flown !== null);
  const theirs = flown.map((one) => missOf(one.flown));
  return flown.length === 0 ? `${own}.` : `${own}; ${part("what flew", theirs)}.`;
}
