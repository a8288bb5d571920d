/** From what a person chose to what the server is asked, or why it cannot be asked yet. */

import type { Schema } from "../../session/client";
import type { Throw } from "../../session/live";
import { count as counted } from "../../words/format";

export type Wish = {
  by: "newest" | "hand";
  count: number;
  mode: "any" | "2d" | "3d";
  /** What they are compared with: reference throws that are kept, throws of this machine that are ticked, or
   * healthy machines of the type. */
  against: "kept" | "machine" | "type";
  /** An effect that moves the impact by less is reported as seen, not claimed; null claims every one. */
  materialCm: number | null;
};

type Asked = { body: Schema["GapRunRequest"] | null; problem: string | null };

export const MIN_THROWS = 6;
const MAX_THROWS = 60;
export const MIN_HEALTHY = 3;

type Ids = ReadonlySet<string>;

/** Throws of the mode that was chosen, newest first as they came. */
export const fittingOf = (wish: Wish, throws: readonly Throw[]) =>
  throws.filter((row) => wish.mode === "any" || row.mode === wish.mode);

/** Throws that a wish would diagnose; none of them can be compared with. */
export function diagnosedOf(wish: Wish, throws: readonly Throw[], chosen: Ids): Ids {
  const fitting = fittingOf(wish, throws);
  const rows =
    wish.by === "newest"
      ? fitting.slice(0, wish.count)
      : fitting.filter((row) => chosen.has(row.throw_id));
  return new Set(rows.map((row) => row.throw_id));
}

/** `throws` are those that landed and have a log, `healthy` those ticked to compare with. */
export function wishOf(wish: Wish, throws: readonly Throw[], chosen: Ids, healthy: Ids): Asked {
  const fitting = fittingOf(wish, throws);
  if (fitting.length < MIN_THROWS) {
    const what = wish.mode === "any" ? "" : ` ${wish.mode.toUpperCase()}`;
    return refused(
      `${counted(fitting.length, "throw")}${what} landed with a log; at least ${MIN_THROWS} are needed, better 12 at mixed targets. Throw more.`,
    );
  }
  const diagnosed = diagnosedOf(wish, throws, chosen);
  const ids = [...diagnosed];
  if (wish.by === "hand") {
    if (ids.length < MIN_THROWS) return refused(`${ids.length} chosen, at least ${MIN_THROWS}.`);
    if (ids.length > MAX_THROWS) return refused(`${ids.length} chosen, at most ${MAX_THROWS}.`);
  }
  const body: Schema["GapRunRequest"] =
    wish.by === "hand"
      ? { throw_ids: ids }
      : { newest_count: wish.count, mode: wish.mode === "any" ? null : wish.mode };
  if (wish.materialCm !== null) body.material_m = wish.materialCm / 100;
  if (wish.against === "kept") return { body, problem: null };
  if (wish.against === "type") return { body: { ...body, against: "type" }, problem: null };
  const reference = [...healthy].filter((id) => !diagnosed.has(id));
  const have = `${counted(reference.length, "healthy throw")} chosen`;
  if (reference.length < MIN_HEALTHY) return refused(`${have}, at least ${MIN_HEALTHY}.`);
  if (reference.length > MAX_THROWS) return refused(`${have}, at most ${MAX_THROWS}.`);
  return { body: { ...body, reference_throw_ids: reference }, problem: null };
}

const refused = (problem: string): Asked => ({ body: null, problem });
