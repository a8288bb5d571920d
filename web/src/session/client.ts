/** Typed HTTP client of the console. Every failure becomes an `ApiError` with a sentence for people. */

import createClient from "openapi-fetch";
import type { components, paths } from "../api/schema";

export type Schema = components["schemas"];

type ErrorBody = { error?: { code?: string; message?: string; detail?: unknown } };

export class ApiError extends Error {
  constructor(
    readonly status: number,
    readonly code: string,
    message: string,
    readonly detail: unknown = null,
  ) {
    super(message);
  }
}

export const api = createClient<paths>({
  baseUrl: globalThis.location?.origin ?? "http://localhost",
  headers: { "X-Requested-With": "downrange" },
  credentials: "same-origin",
});

type Answer<T> = { data?: T; error?: unknown; response: Response };

/** Turn an answer into its data, or throw what went wrong. */
export async function take<T>(call: Promise<Answer<T>>): Promise<T> {
  let answer: Answer<T>;
  try {
    answer = await call;
  } catch {
    throw new ApiError(0, "offline", "The server does not answer.");
  }
  if (answer.response.ok) return answer.data as T;
  throw toApiError(answer.response.status, answer.error);
}

export function toApiError(status: number, body: unknown): ApiError {
  const error = (body as ErrorBody | undefined)?.error;
  if (error?.code && error.message) {
    return new ApiError(status, error.code, error.message, error.detail ?? null);
  }
  return new ApiError(status, `http_${status}`, `The server answered ${status} without a reason.`);
}
