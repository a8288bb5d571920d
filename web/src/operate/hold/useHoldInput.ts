/**
 * Pointer, touch and key as one press: whatever could mean that nobody holds the button any more is
 * letting go (pointer up or cancel, lost capture, blur of button or window, page hidden).
 *
 * A press outlives the throw it started: until the finger or key is lifted, `isDown` stays true and
 * nothing new begins. The page keeps the button in its place for as long, so that lifting the finger
 * presses nothing else.
 */

import { useEffect, useRef, useState } from "react";
import type { ReleaseCause } from "./hold";

type Input = {
  press: () => void;
  release: (cause: ReleaseCause) => void;
  /** The button may be pressed now; a running press does not depend on it. */
  isEnabled: boolean;
  /** Whether a finger, mouse button or key is down, also after the throw has ended. */
  onDown: (isDown: boolean) => void;
};

type Source = "pointer" | "key";

const HOLD_KEY = " ";

export function useHoldInput({ press, release, isEnabled, onDown }: Input) {
  /** What holds the throw. */
  const source = useRef<Source | null>(null);
  const [isDown, setIsDown] = useIsDown(onDown);

  const begin = (by: Source, pointerId: number | null) => {
    if (!isEnabled || source.current !== null) return;
    source.current = by;
    setIsDown(by, pointerId);
    press();
  };
  const end = (cause: ReleaseCause, by?: Source) => {
    if (source.current === null || (by && source.current !== by)) return;
    source.current = null;
    release(cause);
  };

  const endRef = useRef(end);
  endRef.current = end;
  useEffect(() => {
    const onBlur = () => endRef.current("blur");
    const onHidden = () => document.visibilityState !== "visible" && endRef.current("hidden");
    window.addEventListener("blur", onBlur);
    window.addEventListener("pagehide", onBlur);
    document.addEventListener("visibilitychange", onHidden);
    return () => {
      window.removeEventListener("blur", onBlur);
      window.removeEventListener("pagehide", onBlur);
      document.removeEventListener("visibilitychange", onHidden);
      endRef.current("cancelled");
    };
  }, []);

  const handlers = {
    onPointerDown: (event: React.PointerEvent<HTMLButtonElement>) => {
      if (event.button !== 0 || !event.isPrimary) return;
      event.currentTarget.focus();
      event.currentTarget.setPointerCapture?.(event.pointerId);
      begin("pointer", event.pointerId);
    },
    onPointerUp: () => end("released", "pointer"),
    onPointerCancel: () => end("cancelled", "pointer"),
    onLostPointerCapture: () => end("released", "pointer"),
    onKeyDown: (event: React.KeyboardEvent) => {
      if (event.key === "Escape") end("released");
      if (event.key !== HOLD_KEY) return;
      event.preventDefault();
      if (!event.repeat) begin("key", null);
    },
    onKeyUp: (event: React.KeyboardEvent) => {
      if (event.key === HOLD_KEY) end("released", "key");
    },
    onBlur: () => end("blur"),
    onContextMenu: (event: React.MouseEvent) => event.preventDefault(),
  };
  return { handlers, isDown };
}

type Down = { by: Source; pointerId: number | null };

/** What is physically down since the last press; cleared where it is lifted, wherever that is. */
function useIsDown(onDown: (isDown: boolean) => void) {
  const [down, setDown] = useState<Down | null>(null);
  const report = useRef(onDown);
  report.current = onDown;
  const isDown = down !== null;
  useEffect(() => report.current(isDown), [isDown]);
  useEffect(() => {
    if (!down) return;
    const lift = () => setDown(null);
    const onPointer = (event: PointerEvent) => event.pointerId === down.pointerId && lift();
    const onKey = (event: KeyboardEvent) => event.key === HOLD_KEY && lift();
    // A first finger that comes down means that the one before was lifted without a sign.
    const onNext = (event: PointerEvent) => event.isPrimary && lift();
    const ends: [string, (event: never) => void][] =
      down.by === "key"
        ? [
            ["keyup", onKey],
            ["blur", lift],
          ]
        : [
            ["pointerup", onPointer],
            ["pointercancel", onPointer],
            ["pointerdown", onNext],
          ];
    for (const [kind, end] of ends)
      window.addEventListener(kind, end as EventListener, { capture: true });
    return () => {
      for (const [kind, end] of ends)
        window.removeEventListener(kind, end as EventListener, { capture: true });
    };
  }, [down]);
  const begin = (by: Source, pointerId: number | null) => setDown({ by, pointerId });
  return [isDown, begin] as const;
}
