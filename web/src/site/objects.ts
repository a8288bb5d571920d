/** Boxes, pits and piles around a machine as the operator types them: by range and azimuth. */

import type { Schema } from "../session/client";
import { bearingWords, metres, signed } from "../words/format";

export type SiteObject = Schema["SiteObject"];
export type Kind = SiteObject["kind"];

export const KINDS: readonly Kind[] = ["box", "pit", "pile"];
const FIRST_RANGE_M = 9;

const NEW: Record<Kind, Partial<SiteObject>> = {
  box: { length_m: 4, width_m: 2.4, height_m: 1.2 },
  pit: { length_m: 2, width_m: 2, height_m: 0.8 },
  pile: { length_m: 3, width_m: 3, height_m: 1 },
};

/** A new object where the target is, or ahead, with a name that nothing has yet. */
export function newObject(
  kind: Kind,
  others: readonly SiteObject[],
  at: { x_m: number; y_m: number } | null,
): SiteObject {
  const names = new Set(others.map((other) => other.name.toLowerCase()));
  let number = 1;
  while (names.has(`${kind} ${number}`)) number += 1;
  return {
    name: `${kind} ${number}`,
    kind,
    x_m: at?.x_m ?? FIRST_RANGE_M,
    y_m: at?.y_m ?? 0,
    turn_rad: at ? Math.atan2(at.y_m, at.x_m) : 0,
    length_m: 1,
    width_m: 1,
    height_m: 1,
    base_height_m: 0,
    top_ratio: 0,
    ...NEW[kind],
  };
}

export const rangeOf = (item: SiteObject) => Math.hypot(item.x_m, item.y_m);
export const azimuthOf = (item: SiteObject) => Math.atan2(item.y_m, item.x_m);

/** The same object at another place. */
export function placed(item: SiteObject, range_m: number, azimuth_rad: number): SiteObject {
  return { ...item, x_m: range_m * Math.cos(azimuth_rad), y_m: range_m * Math.sin(azimuth_rad) };
}

/** Height of the surface that loads lie on. */
export function topOf(item: SiteObject): number {
  return item.kind === "pit" ? -item.height_m : (item.base_height_m ?? 0) + item.height_m;
}

/** "9.3 m, 37.1° left, top +1.20 m". */
export function placeWords(item: SiteObject): string {
  const what = item.kind === "pit" ? "floor" : "top";
  const where = `${metres(rangeOf(item), 1)}, ${bearingWords(azimuthOf(item))}`;
  return `${where}, ${what} ${signed(topOf(item))} m`;
}

/** Same objects, field by field. */
export function isSameSite(a: readonly SiteObject[], b: readonly SiteObject[]): boolean {
  return JSON.stringify(a) === JSON.stringify(b);
}
