/** Surveys on their way to the server. */

import { ApiError } from "../session/client";

/** The server's limit; a larger file would travel for nothing. */
const LIMIT_BYTES = 6_000_000;

/** The text of a survey, null without one. */
export async function surveyText(file: File | null): Promise<string | null> {
  if (file === null) return null;
  if (file.size > LIMIT_BYTES)
    throw new ApiError(
      0,
      "too_large",
      `${file.name} has ${(file.size / 1e6).toFixed(1)} MB, at most 6 MB are taken. Use fewer points.`,
    );
  return file.text();
}
