/** Exclusion zones as the operator draws them: corners on the ground and two heights. */

import type { Schema } from "../session/client";
import { metres } from "../words/format";

export type Zone = Schema["Zone"];
export type Zones = Schema["ZonesView"];
export type Corner = [number, number];
export type Tool = "polygon" | "box";

/** A zone on its way: clicks so far. */
export type Drawing = { tool: Tool; corners: Corner[] };

export const MAX_CORNERS = 24;
const MIN_SIDE_M = 0.1;

const round = (value: number) => Math.round(value * 1000) / 1000;

/** The four corners of a box from two opposite ones, along the machine's axes. */
export function boxOf([ax, ay]: Corner, [bx, by]: Corner): Corner[] {
  return [
    [ax, ay],
    [bx, ay],
    [bx, by],
    [ax, by],
  ];
}

/** The drawing after one more click; a box ends with its second corner, if that is not beside the first. */
export function withClick(drawing: Drawing, x_m: number, y_m: number): Drawing {
  const corner: Corner = [round(x_m), round(y_m)];
  const [first] = drawing.corners;
  if (drawing.tool === "box" && first) {
    const isFlat =
      Math.abs(first[0] - corner[0]) < MIN_SIDE_M || Math.abs(first[1] - corner[1]) < MIN_SIDE_M;
    return isFlat ? drawing : { ...drawing, corners: boxOf(first, corner) };
  }
  if (drawing.corners.length >= MAX_CORNERS) return drawing;
  // A double tap is one corner: two at one place make no polygon.
  const last = drawing.corners[drawing.corners.length - 1];
  if (last && Math.hypot(last[0] - corner[0], last[1] - corner[1]) < MIN_SIDE_M) return drawing;
  return { ...drawing, corners: [...drawing.corners, corner] };
}

export const isComplete = ({ tool, corners }: Drawing) => tool === "box" && corners.length === 4;

/** A new zone with a name that nothing has yet. */
export function newZone(corners: Corner[], others: readonly Zone[]): Zone {
  const names = new Set(others.map((other) => other.name.toLowerCase()));
  let number = 1;
  while (names.has(`zone ${number}`)) number += 1;
  return { name: `zone ${number}`, reason: "", corners_m: corners, bottom_m: 0, top_m: 3 };
}

/** "4 corners, 0.0 to 3.0 m". */
export const zoneWords = (zone: Zone) =>
  `${zone.corners_m.length} corners, ${metres(zone.bottom_m, 1)} to ${metres(zone.top_m, 1)}`;

/** Same zones, field by field. */
export const isSame = (a: readonly Zone[], b: readonly Zone[]) =>
  JSON.stringify(a) === JSON.stringify(b);

/** What is in force, and whether the machine has it. */
export function forceWords(zones: Zones, onBoard: string | null | undefined, machine: string) {
  if (zones.approved_version_count === 0) return "None is in force yet.";
  const count = zones.approved.length;
  const what = count === 0 ? "No zone is" : count === 1 ? "1 zone is" : `${count} zones are`;
  const where =
    onBoard === zones.approved_sha256
      ? `${machine} has them.`
      : `${machine} does not have them yet, and does not arm until it does.`;
  const by = `(version ${zones.approved_version_count}, approved by ${zones.approved_by})`;
  return `${what} in force ${by}. ${where}`;
}
