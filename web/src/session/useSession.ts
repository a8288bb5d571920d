/** Who is signed in, and what they may do. */

import { useQuery } from "@tanstack/react-query";
import { ApiError, api, type Schema, take } from "./client";
import { ME } from "./queries";

export type Session = Schema["SessionView"];
export type Permission = Schema["Permission"];

async function fetchMe(): Promise<Session | null> {
  try {
    return (await take(api.GET("/api/v1/auth/me"))) ?? null;
  } catch (error) {
    if (error instanceof ApiError && error.status === 401) return null;
    throw error;
  }
}

/** `undefined` while unknown, `null` when signed out. */
export function useSession(): Session | null | undefined {
  return useQuery({ queryKey: ME, queryFn: fetchMe, staleTime: 60_000 }).data;
}

export function useMay(permission: Permission): boolean {
  return useSession()?.permissions.includes(permission) ?? false;
}
