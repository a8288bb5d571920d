/** Surveys on their way to the server. */

import { ApiError } from "../session/client";

/** The server's limit; a larger file would travel for nothing. */
const LIMIT_BYTES = 6_000_000;
/** What the dialogs offer: text, GeoTIFF, point clouds. */
export const SURVEY_TYPES = ".csv,text/csv,.tif,.tiff,image/tiff,.las,.laz";
const TEXT = /\.(csv|txt)$/i;

export type Survey = { survey_csv: string } | { survey_base64: string };

/** A survey as the server takes it, null without one. */
export async function surveyOf(file: File | null): Promise<Survey | null> {
  if (file === null) return null;
  if (file.size > LIMIT_BYTES)
    throw new ApiError(
      0,
      "too_large",
      `${file.name} has ${(file.size / 1e6).toFixed(1)} MB, at most 6 MB are taken. Use fewer points.`,
    );
  if (TEXT.test(file.name)) return { survey_csv: await file.text() };
  return { survey_base64: base64(new Uint8Array(await file.arrayBuffer())) };
}

/** In parts: a call takes some 100 000 arguments at most. */
function base64(bytes: Uint8Array): string {
  const parts: string[] = [];
  for (let first = 0; first < bytes.length; first += 0x8000)
    parts.push(String.fromCharCode(...bytes.subarray(first, first + 0x8000)));
  return btoa(parts.join(""));
}
