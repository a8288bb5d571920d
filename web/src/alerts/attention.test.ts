import { describe, expect, it } from "vitest";
import { type Alert, attention, inOrder, matches, needsLook, parseAlertSearch } from "./attention";

const NOW = Date.parse("2026-11-27T12:00:00Z");

function alert(id: string, changes: Partial<Alert> = {}): Alert {
  return {
    alert_id: id,
    rule: "lost",
    severity: "error",
    machine_id: "m001",
    text: "",
    opened_utc: "2026-11-27T11:00:00Z",
    seen_utc: "2026-11-27T11:00:00Z",
    cleared_utc: null,
    acknowledged_by: null,
    acknowledged_utc: null,
    note: "",
    silenced_until_utc: null,
    silenced_by: null,
    ...changes,
  };
}

const SEEN = { acknowledged_by: "ada" };
const SILENT = { silenced_until_utc: "2026-11-27T12:00:01Z" };

describe("which alerts call for a look", () => {
  it("leaves out what is cleared, seen or silent", () => {
    expect(needsLook(alert("a"), NOW)).toBe(true);
    expect(needsLook(alert("a", SEEN), NOW)).toBe(false);
    expect(needsLook(alert("a", { cleared_utc: "2026-11-27T11:30:00Z" }), NOW)).toBe(false);
    expect(needsLook(alert("a", SILENT), NOW)).toBe(false);
    expect(needsLook(alert("a", SILENT), NOW + 2000)).toBe(true);
  });

  it("counts them, red only for stops and faults", () => {
    expect(attention([alert("a", SEEN)], NOW)).toBeNull();
    expect(attention([alert("a")], NOW)).toEqual({
      alert_count: 1,
      tone: "look",
      words: "1 alert needs a look",
    });
    const both = attention([alert("a"), alert("b", { rule: "fault" })], NOW);
    expect(both?.tone).toBe("alarm");
    expect(both?.words).toBe("2 alerts need a look");
    expect(attention([alert("b", { rule: "fault", ...SEEN }), alert("a")], NOW)?.tone).toBe("look");
  });

  it("puts them first, then the newest", () => {
    const rows = [alert("a"), alert("c", SEEN), alert("b"), alert("d", SEEN)];
    expect(inOrder(rows, NOW).map((row) => row.alert_id)).toEqual(["b", "a", "d", "c"]);
  });
});

describe("filters in the address", () => {
  it("keeps what it knows and leaves out the rest", () => {
    expect(parseAlertSearch({ state: "cleared", machine: "m1", rule: "disk" })).toEqual({
      state: "cleared",
      machine: "m1",
      rule: "disk",
    });
    expect(parseAlertSearch({ state: "webhooks" })).toEqual({ state: "webhooks" });
    expect(parseAlertSearch({ state: "open", machine: 3, rule: "x" })).toEqual({});
  });

  it("chooses by machine and kind", () => {
    expect(matches(alert("a"), {})).toBe(true);
    expect(matches(alert("a"), { machine: "m002" })).toBe(false);
    expect(matches(alert("a"), { rule: "disk" })).toBe(false);
    expect(matches(alert("a"), { machine: "m001", rule: "lost" })).toBe(true);
  });
});
