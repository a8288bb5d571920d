import { describe, expect, it } from "vitest";
import type { Throw } from "../session/live";
import { type Wish, wishOf } from "./wish";

const throws = Array.from({ length: 10 }, (_, index) => ({
  throw_id: `t${index}`,
  mode: index < 7 ? "3d" : "2d",
})) as Throw[];
const none: ReadonlySet<string> = new Set();
const newest: Wish = { by: "newest", count: 12, mode: "any" };

describe("a wish for a diagnosis", () => {
  it("asks for the newest", () => {
    expect(wishOf(newest, throws, none).body).toEqual({ newest_count: 12, mode: null });
    expect(wishOf({ ...newest, mode: "3d" }, throws, none).body?.mode).toBe("3d");
  });

  it("says what is missing before it is asked", () => {
    const { body, problem } = wishOf({ ...newest, mode: "2d" }, throws, none);
    expect(body).toBeNull();
    expect(problem).toContain("3 throws 2D landed");
    expect(wishOf(newest, [], none).problem).toContain("Throw more.");
  });

  it("names throws by hand, of the mode shown", () => {
    const chosen = new Set(throws.map((row) => row.throw_id));
    const hand: Wish = { ...newest, by: "hand" };
    expect(wishOf(hand, throws, none).problem).toBe("0 chosen, at least 6.");
    expect(wishOf(hand, throws, chosen).body?.throw_ids).toHaveLength(10);
    expect(wishOf({ ...hand, mode: "3d" }, throws, chosen).body?.throw_ids).toHaveLength(7);
  });
});
