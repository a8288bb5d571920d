/** The machine that this console looks at; remembered on this computer. */

import { useLocalStorage } from "@mantine/hooks";
import type { Machine } from "../session/live";
import { useLive } from "../session/liveStore";

const KEY = "downrange.machine";

export function useMachineId(): [string | null, (id: string) => void] {
  const [chosen, choose] = useLocalStorage<string>({ key: KEY, defaultValue: "" });
  const id = useLive((live) =>
    chosen in live.machines ? chosen : (Object.keys(live.machines).sort()[0] ?? null),
  );
  return [id, choose];
}

export function useMachine(): Machine | null {
  const [id] = useMachineId();
  return useLive((live) => (id === null ? null : (live.machines[id] ?? null)));
}
