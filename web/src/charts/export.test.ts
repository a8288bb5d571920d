import { describe, expect, it } from "vitest";
import { fileName, toCsv } from "./export";

describe("CSV", () => {
  it("quotes what needs quotes", () => {
    expect(toCsv(["a", "b"], [['say "x"', "1,5"]])).toBe('a,b\r\n"say ""x""","1,5"');
  });

  it("keeps numbers as they are, and unknown ones empty", () => {
    expect(toCsv(["m"], [[-0.125], [null], [0]])).toBe("m\r\n-0.125\r\n\r\n0");
  });

  it("disarms formulas in texts", () => {
    expect(toCsv(["note"], [["=1+1"], ["@x"]])).toBe("note\r\n'=1+1\r\n'@x");
  });
});

it("names files after the chart", () => {
  expect(fileName("Impacts, throw coordinates")).toBe("downrange-impacts-throw-coordinates");
});
