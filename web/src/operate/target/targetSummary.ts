/** Mode and target in one line of the panel: "2D · 8.50 m · 0.0° ahead · +1.20 m high". */

import { bearingWords, heightWords, metres } from "../../words/format";
import type { Target } from "./target";

/** Where the line is too narrow it breaks between its parts, never inside one. */
export function targetSummary(mode: "2d" | "3d", target: Target | null): string {
  const parts = [mode.toUpperCase()];
  if (target) {
    parts.push(metres(target.range_m), bearingWords(target.azimuth_rad));
    const height = heightWords(target.z_m, "");
    if (height) parts.push(height);
  }
  return parts.map((part) => part.replaceAll(" ", "\u00a0")).join("\u00a0· ");
}
