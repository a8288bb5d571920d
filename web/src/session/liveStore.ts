/** The store around the live reducer, and the hook that reads a slice of it. */

import { useSyncExternalStore } from "react";
import { EMPTY_LIVE, type Live, type LiveAction, reduceLive } from "./live";

let state: Live = EMPTY_LIVE;
const listeners = new Set<() => void>();

export function dispatchLive(action: LiveAction): void {
  const next = reduceLive(state, action);
  if (next === state) return;
  state = next;
  for (const listener of listeners) listener();
}

export const readLive = (): Live => state;

function subscribe(listener: () => void): () => void {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

/** Re-renders only when the selected slice changes; select existing objects or plain values. */
export function useLive<T>(select: (live: Live) => T): T {
  return useSyncExternalStore(subscribe, () => select(state));
}
