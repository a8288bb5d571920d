import { act, cleanup, render, screen } from "@testing-library/react";
import { afterEach, beforeEach, expect, it, vi } from "vitest";

import { markData, markOpen } from "../session/connection";
import { OfflineBanner } from "./OfflineBanner";

beforeEach(() => {
  vi.useFakeTimers();
});
afterEach(() => {
  cleanup();
  vi.useRealTimers();
});

it("says nothing of a stream that opens again at once, and says how old the data are of one that does not", () => {
  act(() => {
    markOpen(true);
    markData(Date.now());
  });
  render(<OfflineBanner />);
  act(() => markOpen(false));
  expect(screen.queryByTestId("offline")).toBeNull();
  act(() => vi.advanceTimersByTime(1000));
  expect(screen.queryByTestId("offline")).toBeNull();
  act(() => vi.advanceTimersByTime(2000));
  expect(screen.getByTestId("offline").textContent).toContain("last data 3 s ago");
});
