/** The time zone in which times are shown: this computer's, UTC, or that of the site; kept on this computer. */

import { useSyncExternalStore } from "react";

const KEY = "downrange.zone";
const listeners = new Set<() => void>();

function isZone(name: string): boolean {
  try {
    new Intl.DateTimeFormat("en-GB", { timeZone: name });
    return true;
  } catch {
    return false;
  }
}

const known = (name: string) => (name !== "" && isZone(name) ? name : undefined);

let zone = known(globalThis.localStorage?.getItem(KEY) ?? "");

/** IANA name; undefined is this computer's own. */
export const chosenZone = (): string | undefined => zone;

export function chooseZone(name: string): void {
  zone = known(name);
  // Without a page, as in tests, there is nothing to keep it in.
  globalThis.localStorage?.setItem(KEY, zone ?? "");
  for (const listener of listeners) listener();
}

function subscribe(listener: () => void): () => void {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

export const useZone = (): string => useSyncExternalStore(subscribe, () => zone ?? "");

/** Names that this browser knows, UTC first. */
export function zoneNames(): string[] {
  return ["UTC", ...Intl.supportedValuesOf("timeZone").filter((name) => name !== "UTC")];
}
