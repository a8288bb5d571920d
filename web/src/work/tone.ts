/** Heights as a picture: the higher, the stronger the tone. */

import type { Heights } from "./surface";

const STRONGEST = 0.62;
const TONE = { light: [52, 66, 84], dark: [196, 208, 222] } as const;

/** Strength of the tone of a height, 0 to 255. */
export function strength(height: number, low: number, high: number): number {
  const part = high - low < 1e-6 ? 0 : (height - low) / (high - low);
  return Math.round(255 * STRONGEST * Math.min(Math.max(part, 0), 1));
}

/** A picture with a pixel a cell, left of the machine up; null where nothing can be drawn. */
export function tonePicture(
  heights: Heights,
  low: number,
  high: number,
  isDark: boolean,
): string | null {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [heights[0]?.length ?? 0, heights.length];
  const context = canvas.getContext("2d");
  if (!context || canvas.width === 0 || canvas.height === 0) return null;
  const picture = context.createImageData(canvas.width, canvas.height);
  const [red, green, blue] = isDark ? TONE.dark : TONE.light;
  heights.forEach((line, row) => {
    const above = canvas.height - 1 - row;
    line.forEach((height, column) => {
      picture.data.set(
        [red, green, blue, strength(height, low, high)],
        4 * (above * canvas.width + column),
      );
    });
  });
  context.putImageData(picture, 0, 0);
  return canvas.toDataURL();
}
