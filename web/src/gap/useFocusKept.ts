import { useEffect, useRef } from "react";

/**
 * Props for a group of buttons: the keyboard's place stays in it while the pressed one is disabled
 * or another takes its stead, and its pop-overs count as part of it.
 */
export function useFocusKept<T extends HTMLElement>() {
  const ref = useRef<T>(null);
  const isOurs = useRef(false);
  useEffect(() => {
    const leave = () => {
      isOurs.current = false;
    };
    // Before React's own handlers: those say so where the focus or the pointer is ours after all.
    document.addEventListener("focusin", leave, true);
    document.addEventListener("pointerdown", leave, true);
    return () => {
      document.removeEventListener("focusin", leave, true);
      document.removeEventListener("pointerdown", leave, true);
    };
  }, []);
  useEffect(() => {
    if (isOurs.current && document.activeElement === document.body)
      ref.current?.querySelector<HTMLElement>("button:not(:disabled)")?.focus();
  });
  return {
    ref,
    onFocus: () => {
      isOurs.current = true;
    },
  };
}
