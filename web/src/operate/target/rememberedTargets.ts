/** Targets that this computer remembers of a machine: the last ones thrown at, and those with a name. */

import { useLocalStorage } from "@mantine/hooks";
import { useCallback } from "react";
import { fromPoint, isSameTarget, type Target } from "./target";

export type SavedTarget = { name: string; x_m: number; y_m: number; z_m: number };
export type Saved = { named: readonly SavedTarget[]; recent: readonly SavedTarget[] };

export const NONE_SAVED: Saved = { named: [], recent: [] };
export const RECENT_COUNT = 5;
const NAMED_COUNT = 50;

export const pointOf = ({ x_m, y_m, z_m }: SavedTarget): Target => fromPoint(x_m, y_m, z_m);

const saved = (name: string, { x_m, y_m, z_m }: Target): SavedTarget => ({ name, x_m, y_m, z_m });

/** The newest stands first, each once. */
export function withRecent(all: Saved, target: Target): Saved {
  const others = all.recent.filter((other) => !isSameTarget(pointOf(other), target));
  return { ...all, recent: [saved("", target), ...others].slice(0, RECENT_COUNT) };
}

/** A name that is known moves to the new place. */
export function withName(all: Saved, name: string, target: Target): Saved {
  const others = all.named.filter((other) => other.name !== name);
  const named = [...others, saved(name, target)].sort((a, b) => a.name.localeCompare(b.name));
  return { ...all, named: named.slice(0, NAMED_COUNT) };
}

export const withoutName = (all: Saved, name: string): Saved => ({
  ...all,
  named: all.named.filter((other) => other.name !== name),
});

export function useSavedTargets(machineId: string) {
  const [all, setAll] = useLocalStorage<Saved>({
    key: `downrange.targets.${machineId}`,
    defaultValue: NONE_SAVED,
    getInitialValueInEffect: false,
  });
  const noteThrown = useCallback(
    (target: Target) => setAll((old) => withRecent(old, target)),
    [setAll],
  );
  return {
    all,
    noteThrown,
    keep: (name: string, target: Target) => setAll((old) => withName(old, name, target)),
    forget: (name: string) => setAll((old) => withoutName(old, name)),
  };
}
