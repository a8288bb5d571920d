/** Where the one 3D view of this page is shown: the rectangle of the page that wants it. */

import { useEffect, useState, useSyncExternalStore } from "react";

export type Slot = { left: number; top: number; width: number; height: number };

let slot: Slot | null = null;
let wasWanted = false;
const listeners = new Set<() => void>();

function set(next: Slot | null): void {
  slot = next;
  wasWanted ||= next !== null;
  for (const listener of listeners) listener();
}

function subscribe(listener: () => void): () => void {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

export const useSlot = (): Slot | null => useSyncExternalStore(subscribe, () => slot);

/** The view is loaded when first wanted, and stays loaded from then on. */
export const useWasWanted = (): boolean => useSyncExternalStore(subscribe, () => wasWanted);

/** Put the view over an element for as long as it is on the page; give the result as its `ref`. */
export function useViewSlot<T extends HTMLElement>() {
  const [element, setElement] = useState<T | null>(null);
  useEffect(() => {
    if (!element) return;
    const measure = () => {
      const { left, top, width, height } = element.getBoundingClientRect();
      set({ left, top, width, height });
    };
    const observer = new ResizeObserver(measure);
    // All around it, too: a banner above that goes moves the element without a change of its size.
    for (let each: Element | null = element; each; each = each.parentElement)
      observer.observe(each);
    window.addEventListener("scroll", measure, { capture: true, passive: true });
    measure();
    return () => {
      observer.disconnect();
      window.removeEventListener("scroll", measure, { capture: true });
      set(null);
    };
  }, [element]);
  return setElement;
}
