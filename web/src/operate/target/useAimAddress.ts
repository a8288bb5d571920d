/** Keeps machine, mode and target in the address of page Operate, and takes them from it when it is opened. */

import { useNavigate, useRouter, useSearch } from "@tanstack/react-router";
import { useEffect, useRef } from "react";
import { useLive } from "../../session/liveStore";
import { aimSearch, targetOf } from "./aimAddress";
import { isSameTarget, type Target } from "./target";

/** A drag gives ten targets a second; browsers limit how often an address changes. */
const SETTLE_MS = 400;

type Aim = {
  machineId: string | null;
  mode: "2d" | "3d";
  target: Target | null;
  /** Nothing is thrown: only then the address may set the target. */
  isFree: boolean;
  chooseMachine: (machineId: string) => void;
  setMode: (mode: "2d" | "3d") => void;
  setPace: (pace_ratio: number) => void;
  setTarget: (target: Target, mode: "2d" | "3d") => void;
};

export function useAimAddress(aim: Aim): void {
  const { machineId, mode, target, isFree } = aim;
  const search = useSearch({ from: "/frame/operate" });
  const navigate = useNavigate({ from: "/operate" });
  const router = useRouter();
  /** What the page was opened with; null once it was taken. */
  const asked = useRef<typeof search | null>(search);
  const latest = useRef(aim);
  latest.current = aim;

  const isKnown = useLive((live) => (search.machine ?? "") in live.machines);
  useEffect(() => {
    const wish = asked.current;
    if (wish === null || machineId === null) return;
    if (wish.machine && wish.machine !== machineId && isKnown) {
      // The rest is taken when this machine is shown.
      latest.current.chooseMachine(wish.machine);
      return;
    }
    asked.current = null;
    if (!isFree || (wish.machine && wish.machine !== machineId)) return;
    const wishMode = wish.mode ?? latest.current.mode;
    if (wishMode !== latest.current.mode) latest.current.setMode(wishMode);
    if (wish.pace !== undefined) latest.current.setPace(wish.pace);
    const point = targetOf(wish);
    if (point && !isSameTarget(point, latest.current.target))
      latest.current.setTarget(point, wishMode);
  }, [machineId, isKnown, isFree]);

  useEffect(() => {
    if (machineId === null) return;
    const timer = setTimeout(() => {
      // A page that is being left must not call the address back.
      const isLeft = router.latestLocation.pathname !== "/operate";
      if (asked.current !== null || isLeft) return;
      void navigate({ search: aimSearch(machineId, mode, target), replace: true });
    }, SETTLE_MS);
    return () => clearTimeout(timer);
  }, [machineId, mode, target, navigate, router]);
}
