import { useEffect, useRef } from "react";
import { nudge, nudgeOfKey, type Target } from "./target";

/** Elements that need the arrow keys themselves. */
const OWN_ARROWS =
  "input, textarea, select, [contenteditable], [role=radio], [role=radiogroup], [role=slider], [role=option], [role=menuitem]";

/** Arrow keys move the target by 5 cm wherever no field needs them. */
export function useNudge(target: Target | null, isEnabled: boolean, move: (t: Target) => void) {
  const latest = useRef({ target, isEnabled, move });
  latest.current = { target, isEnabled, move };
  useEffect(() => {
    const onKey = (event: KeyboardEvent) => {
      const step = nudgeOfKey(event.key);
      const now = latest.current;
      if (!step || !now.target || !now.isEnabled) return;
      if (event.ctrlKey || event.metaKey || event.altKey || event.shiftKey) return;
      if (event.target instanceof Element && event.target.closest(OWN_ARROWS)) return;
      event.preventDefault();
      now.move(nudge(now.target, step.long_m, step.left_m));
    };
    document.addEventListener("keydown", onKey);
    return () => document.removeEventListener("keydown", onKey);
  }, []);
}
