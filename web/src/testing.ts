import { vi } from "vitest";

/** What happy-dom lacks and sliders and segmented controls ask for. */
export function stubResizeObserver() {
  vi.stubGlobal(
    "ResizeObserver",
    class {
      observe() {}
      unobserve() {}
      disconnect() {}
    },
  );
}
