import { describe, expect, it } from "vitest";
import type { Throw } from "../session/live";
import { nextOrder, sorted, sortOf } from "./throwOrder";

const row = (throw_id: string, along: number | null) =>
  ({ throw_id, measured_downrange_error_m: along }) as Throw;
const rows = [row("a", 0.2), row("b", null), row("c", -0.3), row("d", 0.1)];
const ids = (list: readonly Throw[]) => list.map((each) => each.throw_id).join("");

describe("order of a page", () => {
  it("is the server's until a column is chosen", () => {
    expect(sorted(rows, null)).toBe(rows);
  });
  it("goes by the column, what is unknown last in both directions", () => {
    expect(ids(sorted(rows, { key: "along", isDescending: false }))).toBe("cdab");
    expect(ids(sorted(rows, { key: "along", isDescending: true }))).toBe("adcb");
    expect(ids(rows)).toBe("abcd");
  });
  it("turns once, then goes back; another column begins anew", () => {
    const first = nextOrder(null, "along");
    expect(sortOf(first, "along")).toBe("ascending");
    const second = nextOrder(first, "along");
    expect(sortOf(second, "along")).toBe("descending");
    expect(nextOrder(second, "along")).toBeNull();
    expect(sortOf(nextOrder(second, "time"), "along")).toBe("none");
  });
});
