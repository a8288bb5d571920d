/** A version's files on their way to the server. */

import { ApiError, type Schema, toApiError } from "../session/client";

export const FILE_NAMES = ["policy.onnx", "card.json", "golden_vectors.json"] as const;
const NAMES_IN_WORDS = "policy.onnx, card.json and golden_vectors.json";

/** Why these files are no version; null where they may be sent. The server checks what is in them. */
export function filesRefusal(files: readonly File[]): string | null {
  const names = files.map((file) => file.name);
  const odd = names.find((name) => !(FILE_NAMES as readonly string[]).includes(name));
  if (odd !== undefined) return `${odd} does not belong to a version, which is ${NAMES_IN_WORDS}.`;
  const missing = FILE_NAMES.filter((name) => !names.includes(name));
  if (missing.length > 0)
    return `${missing.join(" and ")} ${missing.length > 1 ? "are" : "is"} missing; a version is ${NAMES_IN_WORDS}.`;
  if (names.length > FILE_NAMES.length) return "A file was chosen twice.";
  return null;
}

/**
 * Send a version.
 *
 * @param onProgress called with the part that has been sent, 0 to 1; fetch cannot tell it.
 * @param signal ends it; the server takes a version in only when all of it has come.
 */
export function uploadPolicy(
  files: readonly File[],
  reason: string,
  onProgress: (ratio: number) => void,
  signal: AbortSignal,
): Promise<Schema["PolicyView"]> {
  const body = new FormData();
  body.append("reason", reason);
  for (const file of files) body.append("files", file, file.name);
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("POST", "/api/v1/policies");
    request.setRequestHeader("X-Requested-With", "downrange");
    request.responseType = "json";
    request.upload.onprogress = (event) =>
      onProgress(event.lengthComputable ? event.loaded / event.total : 0);
    request.onload = () =>
      request.status === 201
        ? resolve(request.response)
        : reject(toApiError(request.status, request.response));
    request.onerror = () => reject(new ApiError(0, "offline", "The server does not answer."));
    request.onabort = () =>
      reject(new ApiError(0, "cancelled", "Cancelled before all of it was sent."));
    signal.addEventListener("abort", () => request.abort());
    request.send(body);
  });
}
