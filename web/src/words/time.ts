/** Local times with the zone shown. The server speaks aware UTC; only this file turns it local. */

function two(value: number): string {
  return String(value).padStart(2, "0");
}

/** "14:03:21" in the zone of this computer. */
export function clockTime(date: Date): string {
  return `${two(date.getHours())}:${two(date.getMinutes())}:${two(date.getSeconds())}`;
}

/** "2026-11-21" in the zone of this computer. */
export function localDate(date: Date): string {
  return `${date.getFullYear()}-${two(date.getMonth() + 1)}-${two(date.getDate())}`;
}

/** "CET", "UTC", "GMT+5:30": name of this computer's zone at that moment. */
export function zoneName(date: Date): string {
  const parts = new Intl.DateTimeFormat("en-GB", { timeZoneName: "short" }).formatToParts(date);
  return parts.find((part) => part.type === "timeZoneName")?.value ?? "local";
}

/** "2026-11-21 14:03:21" from the server's ISO text; the caller shows the zone once. */
export function localStamp(iso: string | null | undefined): string {
  if (!iso) return "–";
  const date = new Date(iso);
  return Number.isNaN(date.getTime()) ? "–" : `${localDate(date)} ${clockTime(date)}`;
}

/** "2026-11-21 14:03:21 CET": where nothing beside it shows the zone. */
export function zonedStamp(iso: string | null | undefined): string {
  const stamp = localStamp(iso);
  return iso && stamp !== "–" ? `${stamp} ${zoneName(new Date(iso))}` : stamp;
}

/** "11-21 14:03:21": as `localStamp` without the year, for narrow tables. */
export const shortStamp = (iso: string | null | undefined) =>
  localStamp(iso).replace(/^\d{4}-/, "");

/** Seconds from an ISO time to now; null where there is none. */
export function ageSeconds(iso: string | null | undefined, nowMs: number): number | null {
  if (!iso) return null;
  const then = Date.parse(iso);
  return Number.isNaN(then) ? null : (nowMs - then) / 1000;
}
