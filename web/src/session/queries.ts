/** The query client: no retries of refusals, and an expired session leads to the login page. */

import { MutationCache, QueryCache, QueryClient } from "@tanstack/react-query";
import { ApiError } from "./client";

export const ME = ["me"] as const;

function isSignedOut(error: unknown): boolean {
  return error instanceof ApiError && error.status === 401;
}

export function createQueryClient(): QueryClient {
  const onError = (error: unknown) => {
    if (isSignedOut(error)) client.setQueryData(ME, null);
  };
  const client = new QueryClient({
    queryCache: new QueryCache({ onError }),
    mutationCache: new MutationCache({ onError }),
    defaultOptions: {
      queries: {
        staleTime: 10_000,
        retry: (failures, error) => failures < 2 && error instanceof ApiError && error.status === 0,
      },
      // A command is never repeated by the console: the server and the machine decide what happened.
      mutations: { retry: false, networkMode: "always" },
    },
  });
  return client;
}
