import { afterEach, describe, expect, it } from "vitest";
import {
  ageSeconds,
  clockTime,
  dayStart,
  instantOf,
  localStamp,
  shortStamp,
  zonedStamp,
  zoneName,
} from "./time";
import { chooseZone } from "./zone";

describe("the chosen zone", () => {
  afterEach(() => chooseZone(""));
  const summer = "2026-07-01T22:30:00Z";

  it("turns every time and is named", () => {
    chooseZone("UTC");
    expect(zonedStamp(summer)).toBe("2026-07-01 22:30:00 UTC");
    chooseZone("Asia/Kolkata");
    expect(localStamp(summer)).toBe("2026-07-02 04:00:00");
    expect(zoneName(new Date(summer))).toBe("GMT+5:30");
  });

  it("begins its days at its own midnight, also where the clock changes", () => {
    chooseZone("Europe/Zurich");
    expect(dayStart("2026-07-01")).toBe("2026-06-30T22:00:00.000Z");
    expect(dayStart("2026-03-29")).toBe("2026-03-28T23:00:00.000Z");
    expect(dayStart("2026-03-29", true)).toBe("2026-03-29T22:00:00.000Z");
    expect(dayStart("2026-10-25", true)).toBe("2026-10-25T23:00:00.000Z");
  });

  it("reads a time that a person typed", () => {
    chooseZone("Asia/Kolkata");
    expect(instantOf("2026-07-02T04:00")).toBe("2026-07-01T22:30:00.000Z");
    chooseZone("Europe/Zurich");
    expect(instantOf("2026-10-25T03:00:01")).toBe("2026-10-25T02:00:01.000Z");
    expect(instantOf("")).toBeNull();
  });

  it("is this computer's where the name is unknown", () => {
    chooseZone("Yard/Nowhere");
    expect(clockTime(new Date(2026, 6, 1, 4, 3, 9))).toBe("04:03:09");
  });
});

describe("local time", () => {
  const date = new Date(2026, 10, 21, 4, 3, 9);

  it("is written in this computer's zone", () => {
    expect(clockTime(date)).toBe("04:03:09");
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
