/** Times in the chosen zone, with the zone shown. The server speaks aware UTC; only this file turns it. */

import { chosenZone } from "./zone";

const DIGITS = {
  year: "numeric",
  month: "2-digit",
  day: "2-digit",
  hour: "2-digit",
  minute: "2-digit",
  second: "2-digit",
  hourCycle: "h23",
} as const;

const formats = new Map<string, Intl.DateTimeFormat>();

/** Formats are costly to make and few. */
function formatOf(zone: string | undefined): Intl.DateTimeFormat {
  const key = zone ?? "";
  const known = formats.get(key);
  if (known) return known;
  // Swedish dates are those of ISO 8601: "2026-11-21 14:03:21".
  const made = new Intl.DateTimeFormat("sv-SE", { ...DIGITS, timeZone: zone });
  formats.set(key, made);
  return made;
}

const stampOf = (date: Date, zone = chosenZone()) => formatOf(zone).format(date);

/** "14:03:21" */
export const clockTime = (date: Date) => stampOf(date).slice(11);

/** "CET", "UTC", "GMT+5:30": name of the zone at that moment. */
export function zoneName(date: Date): string {
  const parts = new Intl.DateTimeFormat("en-GB", {
    timeZoneName: "short",
    timeZone: chosenZone(),
  }).formatToParts(date);
  return parts.find((part) => part.type === "timeZoneName")?.value ?? "local";
}

/** "2026-11-21 14:03:21" from the server's ISO text; the caller shows the zone once. */
export function localStamp(iso: string | null | undefined): string {
  if (!iso) return "–";
  const date = new Date(iso);
  return Number.isNaN(date.getTime()) ? "–" : stampOf(date);
}

/** "2026-11-21 14:03:21 CET": where nothing beside it shows the zone. */
export function zonedStamp(iso: string | null | undefined): string {
  const stamp = localStamp(iso);
  return iso && stamp !== "–" ? `${stamp} ${zoneName(new Date(iso))}` : stamp;
}

/** "11-21 14:03:21": as `localStamp` without the year, for narrow tables. */
export const shortStamp = (iso: string | null | undefined) =>
  localStamp(iso).replace(/^\d{4}-/, "");

/** Begin of a day "2026-11-21" in the chosen zone, as ISO text in UTC; with `next`, of the day after. */
export function dayStart(day: string, next = false): string {
  const [year = 0, month = 1, date = 1] = day.split("-").map(Number);
  return atWall(Date.UTC(year, month - 1, date + (next ? 1 : 0)));
}

/** ISO text in UTC of "2026-11-21T14:03:21" (seconds may be left out) in the chosen zone; null for no such time. */
export function instantOf(wall: string): string | null {
  const wall_ms = Date.parse(`${wall}Z`);
  return Number.isNaN(wall_ms) ? null : atWall(wall_ms);
}

/** The moment at which the clock of the chosen zone shows what that of UTC shows at `wall_ms`. */
function atWall(wall_ms: number): string {
  const offsetAt = (at_ms: number) =>
    Date.parse(`${stampOf(new Date(at_ms)).replace(" ", "T")}Z`) - at_ms;
  // The second pass is for the days on which the clock changes.
  const guess_ms = wall_ms - offsetAt(wall_ms);
  return new Date(wall_ms - offsetAt(guess_ms)).toISOString();
}

/** Seconds from an ISO time to now; null where there is none. */
export function ageSeconds(iso: string | null | undefined, nowMs: number): number | null {
  if (!iso) return null;
  const then = Date.parse(iso);
  return Number.isNaN(then) ? null : (nowMs - then) / 1000;
}
