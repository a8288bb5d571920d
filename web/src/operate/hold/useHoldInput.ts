/**
 * Pointer, touch and key as one press: whatever could mean that nobody holds the button any more is
 * letting go (pointer up or cancel, lost capture, blur of button or window, page hidden).
 */

import { useEffect, useRef } from "react";
import type { ReleaseCause } from "./hold";

type Input = {
  press: () => void;
  release: (cause: ReleaseCause) => void;
  /** The button may be pressed now; a running press does not depend on it. */
  isEnabled: boolean;
};

const HOLD_KEY = " ";

export function useHoldInput({ press, release, isEnabled }: Input) {
  const source = useRef<"pointer" | "key" | null>(null);

  const begin = (by: "pointer" | "key") => {
    if (!isEnabled || source.current !== null) return;
    source.current = by;
    press();
  };
  const end = (cause: ReleaseCause, by?: "pointer" | "key") => {
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

  return {
    onPointerDown: (event: React.PointerEvent<HTMLButtonElement>) => {
      if (event.button !== 0 || !event.isPrimary) return;
      event.currentTarget.focus();
      event.currentTarget.setPointerCapture?.(event.pointerId);
      begin("pointer");
    },
    onPointerUp: () => end("released", "pointer"),
    onPointerCancel: () => end("cancelled", "pointer"),
    onLostPointerCapture: () => end("released", "pointer"),
    onKeyDown: (event: React.KeyboardEvent) => {
      if (event.key === "Escape") end("released");
      if (event.key !== HOLD_KEY) return;
      event.preventDefault();
      if (!event.repeat) begin("key");
    },
    onKeyUp: (event: React.KeyboardEvent) => {
      if (event.key === HOLD_KEY) end("released", "key");
    },
    onBlur: () => end("blur"),
    onContextMenu: (event: React.MouseEvent) => event.preventDefault(),
  };
}
