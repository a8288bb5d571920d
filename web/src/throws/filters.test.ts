import { describe, expect, it } from "vitest";
import { csvHref, isFiltered, parseSearch, toQuery } from "./filters";

describe("filters in the address", () => {
  it("keep what they understand", () => {
    const search = {
      machine: "m001",
      mode: "3d",
      outcome: "landed",
      min: "8.5",
      max: 10,
      since: "2026-11-01",
      group: "mode",
      cursor: "abc",
    };
    expect(parseSearch(search)).toEqual({ ...search, min: 8.5 });
  });

  it("leave out what makes no sense, without an error", () => {
    const search = {
      mode: "4d",
      outcome: "lost",
      min: "near",
      max: -3,
      since: "yesterday",
      until: "2026-99-99",
      group: "colour",
      machine: "",
      unrelated: "x",
    };
    expect(parseSearch(search)).toEqual({});
  });

  it("read a machine whose name is a number", () => {
    expect(parseSearch({ machine: 7 })).toEqual({ machine: "7" });
  });

  it("survive a round trip through an address", () => {
    const filters = parseSearch({ machine: "m 1&x", mode: "2d", min: 7.5, until: "2026-11-21" });
    const address = new URLSearchParams(
      Object.entries(filters).map(([key, value]) => [key, String(value)]),
    );
    expect(parseSearch(Object.fromEntries(address))).toEqual(filters);
  });
});

describe("filters to the server", () => {
  it("cover whole local days, last day included", () => {
    const query = toQuery({ since: "2026-11-20", until: "2026-11-20" });
    const span = Date.parse(query.until ?? "") - Date.parse(query.since ?? "");
    expect(new Date(query.since ?? "").getHours()).toBe(0);
    expect(span).toBe(24 * 3600 * 1000);
  });

  it("name policies by hash and ranges in metres", () => {
    expect(toQuery({ policy: "ab12", min: 8 })).toMatchObject({
      policy_sha256: "ab12",
      min_range_m: 8,
    });
  });

  it("stand in the CSV's address, escaped", () => {
    expect(csvHref({})).toBe("/api/v1/throws/export.csv");
    expect(csvHref({ machine: "m 1&x" })).toBe("/api/v1/throws/export.csv?machine_id=m+1%26x");
  });

  it("know whether any is set", () => {
    expect(isFiltered({})).toBe(false);
    expect(isFiltered({ mode: "2d" })).toBe(true);
  });
});
