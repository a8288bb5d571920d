import { describe, expect, it } from "vitest";
import type { Throw } from "../../session/live";
import { type Wish, wishOf } from "./wish";

const throws = Array.from({ length: 10 }, (_, index) => ({
  throw_id: `t${index}`,
  mode: index < 7 ? "3d" : "2d",
})) as Throw[];
const none: ReadonlySet<string> = new Set();
const newest: Wish = { by: "newest", count: 12, mode: "any", against: "kept", materialCm: null };

describe("a wish for a diagnosis", () => {
  it("asks for the newest", () => {
    expect(wishOf(newest, throws, none, none).body).toEqual({ newest_count: 12, mode: null });
    expect(wishOf({ ...newest, mode: "3d" }, throws, none, none).body?.mode).toBe("3d");
  });

  it("says what is missing before it is asked", () => {
    const { body, problem } = wishOf({ ...newest, mode: "2d" }, throws, none, none);
    expect(body).toBeNull();
    expect(problem).toContain("3 throws 2D landed");
    expect(wishOf(newest, [], none, none).problem).toContain("Throw more.");
  });

  it("names throws by hand, of the mode shown", () => {
    const chosen = new Set(throws.map((row) => row.throw_id));
    const hand: Wish = { ...newest, by: "hand" };
    expect(wishOf(hand, throws, none, none).problem).toBe("0 chosen, at least 6.");
    expect(wishOf(hand, throws, chosen, none).body?.throw_ids).toHaveLength(10);
    expect(wishOf({ ...hand, mode: "3d" }, throws, chosen, none).body?.throw_ids).toHaveLength(7);
  });

  it("asks in metres for what matters in centimetres", () => {
    const asked = wishOf({ ...newest, materialCm: 5 }, throws, none, none).body;
    expect(asked).toEqual({ newest_count: 12, mode: null, material_m: 0.05 });
  });

  it("takes healthy throws that are not diagnosed", () => {
    const own: Wish = { ...newest, count: 6, against: "machine" };
    const all = new Set(throws.map((row) => row.throw_id));
    expect(wishOf(own, throws, none, all).body).toEqual({
      newest_count: 6,
      mode: null,
      reference_throw_ids: ["t6", "t7", "t8", "t9"],
    });
    const hand: Wish = { ...own, by: "hand" };
    const six = new Set(["t0", "t1", "t2", "t3", "t4", "t5"]);
    expect(wishOf(hand, throws, six, new Set(["t5", "t7", "t8"])).problem).toBe(
      "2 healthy throws chosen, at least 3.",
    );
    expect(wishOf(hand, throws, six, all).body?.reference_throw_ids).toHaveLength(4);
    expect(wishOf({ ...own, against: "type" }, throws, none, all).body).toEqual({
      newest_count: 6,
      mode: null,
      against: "type",
    });
  });
});
