/** What another version would have done in recorded throws. */

import { useMutation } from "@tanstack/react-query";
import { api, type Schema, take } from "../session/client";
import { crossrangeWords, downrangeWords, fixed, signed } from "../words/format";

export type Shadow = Schema["ShadowReport"];
export type ShadowThrow = Shadow["throws"][number];
export type Miss = { downrange_m: number; crossrange_m: number };

export function useShadow() {
  return useMutation({
    mutationFn: ({ sha256, ...body }: Schema["ShadowRequest"] & { sha256: string }) =>
      take(
        api.POST("/api/v1/policies/{policy_sha256}/shadow", {
          params: { path: { policy_sha256: sha256 } },
          body,
        }),
      ),
  });
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
