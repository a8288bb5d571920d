/** Everything the Operate page knows, put together: machine, target, plan, hold, result, gate. */

import { useLocalStorage } from "@mantine/hooks";
import { useEffect, useState } from "react";
import { isMoving } from "../machine/phase";
import { useIsHolder } from "../machine/useLease";
import { useMachine, useMachineId } from "../machine/useMachine";
import { staleSeconds, useConnection } from "../session/connection";
import { useLive } from "../session/liveStore";
import { useNow } from "../session/useNow";
import { useSession } from "../session/useSession";
import { operateGate } from "./gate";
import { isAbortable } from "./hold/hold";
import { useHold } from "./hold/useHold";
import { usePlan } from "./preview/usePlan";
import { presentStep } from "./steps";
import { DEFAULT_PACE_RATIO } from "./target/pace";
import { useSavedTargets } from "./target/rememberedTargets";
import { pointKey } from "./target/target";
import { useAimAddress } from "./target/useAimAddress";
import { useTarget } from "./target/useTarget";
import { useThrow } from "./useThrow";

export function useOperate() {
  const machine = useMachine();
  const [, chooseMachine] = useMachineId();
  const machineId = machine?.machine_id ?? null;
  const [mode, setMode] = useLocalStorage<"2d" | "3d">({
    key: "downrange.mode",
    defaultValue: "2d",
  });
  const [pace_ratio, setPace] = useLocalStorage<number>({
    key: "downrange.pace",
    defaultValue: DEFAULT_PACE_RATIO,
  });
  const [throwId, setThrowId] = useState<string | null>(null);
  const thrown = useThrow(throwId);
  const [isMarking, setMarking] = useState(false);
  const refusal = useLive((live) => (machineId ? (live.targetRefusals[machineId] ?? "") : ""));
  const aim = useTarget(machineId);
  const target = machine?.target ?? null;

  const isOver = thrown?.phase === "ended";
  const isRunning = (machine !== null && isMoving(machine.lamp)) || (throwId !== null && !isOver);
  const { plan, estimate, error, again } = usePlan(
    machine,
    mode,
    target,
    pace_ratio,
    !isRunning && throwId === null,
  );
  const { noteThrown } = useSavedTargets(machineId ?? "");
  const control = useHold({ machine, plan }, thrown, (id) => {
    setThrowId(id);
    if (target) noteThrown(target);
  });
  const { hold, release } = control;

  const isHolder = useIsHolder(machine);
  useEffect(() => {
    if (!isHolder && isAbortable(hold)) release("disabled");
  }, [isHolder, hold, release]);

  // A result belongs to the machine and the target it was thrown at.
  const throwTargetKey = target ? pointKey(target) : "";
  const isIdle = hold.phase === "idle";
  useResetResult(`${machineId} ${mode} ${pace_ratio} ${throwTargetKey}`, isIdle && isOver, () =>
    setThrowId(null),
  );

  useAimAddress({
    machineId,
    mode,
    target,
    isFree: !isRunning && hold.phase === "idle",
    chooseMachine,
    setMode,
    setPace,
    setTarget: (next, inMode) => void aim.set(next, inMode),
  });

  const session = useSession();
  const stale_s = staleSeconds(useConnection(), useNow());
  const isLoaded = useLive((live) => live.isLoaded);
  const gate = operateGate({
    stale_s,
    isLoaded,
    machine,
    isHolder,
    permissions: session?.permissions ?? [],
    username: session?.username ?? "",
    mode,
    target,
    plan,
    planError: error,
  });
  const result = isOver && isIdle ? thrown : null;
  const hasResult = result !== null;
  useEffect(() => {
    if (!hasResult) setMarking(false);
  }, [hasResult]);
  return {
    machine,
    mode,
    setMode,
    pace_ratio,
    setPace,
    target,
    problem: refusal || aim.error || null,
    setTarget: (next: NonNullable<typeof target>) => void aim.set(next, mode),
    plan,
    estimate,
    previewAgain: again,
    control,
    thrown,
    result,
    throwAgain: () => setThrowId(null),
    isMarking: isMarking && hasResult,
    setMarking,
    gate,
    step: presentStep({ machine, target, plan, hold, result }),
  };
}

export type Operate = ReturnType<typeof useOperate>;

/** Calls `reset` when the key changes while `isShown`. */
function useResetResult(key: string, isShown: boolean, reset: () => void): void {
  const [shownKey, setShownKey] = useState(key);
  useEffect(() => {
    if (key === shownKey) return;
    setShownKey(key);
    if (isShown) reset();
  }, [key, shownKey, isShown, reset]);
}
