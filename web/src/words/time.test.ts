import { describe, expect, it } from "vitest";
import {
  ageSeconds,
  clockTime,
  localDate,
  localStamp,
  shortStamp,
  zonedStamp,
  zoneName,
} from "./time";

describe("local time", () => {
  const date = new Date(2026, 10, 21, 4, 3, 9);

  it("is written in this computer's zone", () => {
    expect(clockTime(date)).toBe("04:03:09");
    expect(localDate(date)).toBe("2026-11-21");
    expect(localStamp(date.toISOString())).toBe("2026-11-21 04:03:09");
    expect(shortStamp(date.toISOString())).toBe("11-21 04:03:09");
  });

  it("names the zone", () => {
    expect(zoneName(date).length).toBeGreaterThan(1);
    expect(zonedStamp(date.toISOString())).toBe(`2026-11-21 04:03:09 ${zoneName(date)}`);
  });

  it("does not invent times", () => {
    expect(localStamp(null)).toBe("–");
    expect(localStamp("soon")).toBe("–");
    expect(zonedStamp("soon")).toBe("–");
    expect(ageSeconds(undefined, 0)).toBeNull();
  });

  it("measures ages", () => {
    expect(ageSeconds("2026-01-01T00:00:00Z", Date.parse("2026-01-01T00:00:14Z"))).toBe(14);
  });
});
