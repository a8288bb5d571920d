/** Whether what is shown is live: the state of the event stream, and when it last said anything. */

import { useSyncExternalStore } from "react";

export type Connection = {
  isOpen: boolean;
  lastDataMs: number | null;
  /** Why the server refuses the stream; null while it does not. */
  refusal: string | null;
};

/** Silence after which the console calls itself not live; the server speaks at least every 2 s. */
export const SILENCE_LIMIT_MS = 5000;

let connection: Connection = { isOpen: false, lastDataMs: null, refusal: null };
const listeners = new Set<() => void>();

function set(next: Connection): void {
  connection = next;
  for (const listener of listeners) listener();
}

export const markOpen = (isOpen: boolean) => {
  const refusal = isOpen ? null : connection.refusal;
  if (isOpen !== connection.isOpen || refusal !== connection.refusal)
    set({ ...connection, isOpen, refusal });
};

export const markRefused = (refusal: string) => set({ ...connection, refusal });

/** Called for every message; kept out of the render path by changing the object in place. */
export const markData = (nowMs: number) => {
  connection.lastDataMs = nowMs;
};

function subscribe(listener: () => void): () => void {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

export const useConnection = (): Connection => useSyncExternalStore(subscribe, () => connection);

/** Age of the data shown if it is not live, else null. */
export function staleSeconds(state: Connection, nowMs: number): number | null {
  const silence = state.lastDataMs === null ? null : nowMs - state.lastDataMs;
  if (state.isOpen && silence !== null && silence < SILENCE_LIMIT_MS) return null;
  return silence === null ? 0 : silence / 1000;
}
