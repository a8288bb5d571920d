/** From what a person chose to what the server is asked, or why it cannot be asked yet. */

import type { Schema } from "../session/client";
import type { Throw } from "../session/live";
import { count as counted } from "../words/format";

export type Wish = { by: "newest" | "hand"; count: number; mode: "any" | "2d" | "3d" };

type Asked = { body: Schema["GapRunRequest"] | null; problem: string | null };

export const MIN_THROWS = 6;
const MAX_THROWS = 60;

/** `throws` are those that landed and have a log. */
export function wishOf(wish: Wish, throws: readonly Throw[], chosen: ReadonlySet<string>): Asked {
  const fitting = throws.filter((row) => wish.mode === "any" || row.mode === wish.mode);
  if (fitting.length < MIN_THROWS) {
    const what = wish.mode === "any" ? "" : ` ${wish.mode.toUpperCase()}`;
    return refused(
      `${counted(fitting.length, "throw")}${what} landed with a log; at least ${MIN_THROWS} are needed, better 12 at mixed targets. Throw more.`,
    );
  }
  if (wish.by === "newest") {
    const mode = wish.mode === "any" ? null : wish.mode;
    return { body: { newest_count: wish.count, mode }, problem: null };
  }
  const ids = fitting.filter((row) => chosen.has(row.throw_id)).map((row) => row.throw_id);
  if (ids.length < MIN_THROWS) return refused(`${ids.length} chosen, at least ${MIN_THROWS}.`);
  if (ids.length > MAX_THROWS) return refused(`${ids.length} chosen, at most ${MAX_THROWS}.`);
  return { body: { throw_ids: ids }, problem: null };
}

const refused = (problem: string): Asked => ({ body: null, problem });
