import {
  createMemoryHistory,
  createRootRoute,
  createRoute,
  createRouter,
  Outlet,
  RouterProvider,
} from "@tanstack/react-router";
import { act, cleanup, render } from "@testing-library/react";
import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { parseAim } from "./aimAddress";
import { fromPolar } from "./target";
import { useAimAddress } from "./useAimAddress";

const target = fromPolar(8, 0, 0);
const setTarget = vi.fn();
const setMode = vi.fn();
const setPace = vi.fn();

function Operate() {
  useAimAddress({
    machineId: "m001",
    mode: "2d",
    target,
    isFree: true,
    chooseMachine: () => undefined,
    setMode,
    setPace,
    setTarget,
  });
  return null;
}

/** Page Throws never finishes loading, as on a slow link. */
function opened(href: string) {
  const root = createRootRoute({ component: Outlet });
  const frame = createRoute({ getParentRoute: () => root, id: "frame", component: Outlet });
  const getParentRoute = () => frame;
  const operate = createRoute({
    getParentRoute,
    path: "/operate",
    validateSearch: parseAim,
    component: Operate,
  });
  const throws = createRoute({
    getParentRoute,
    path: "/throws",
    loader: () => new Promise<void>(() => undefined),
  });
  const router = createRouter({
    routeTree: root.addChildren([frame.addChildren([operate, throws])]),
    history: createMemoryHistory({ initialEntries: [href] }),
  });
  // biome-ignore lint/suspicious/noExplicitAny: the router of the application is another type
  render(<RouterProvider router={router as any} />);
  return router;
}

const pass = (ms: number) => act(() => vi.advanceTimersByTimeAsync(ms));

beforeEach(() => vi.useFakeTimers());
afterEach(() => {
  cleanup();
  vi.useRealTimers();
  vi.clearAllMocks();
});

test("an address sets mode and target once, and then follows the target", async () => {
  const router = opened("/operate?mode=3d&range=9.5");
  await pass(1000);
  expect(setMode).toHaveBeenCalledExactlyOnceWith("3d");
  expect(setTarget.mock.calls[0]?.[0]).toMatchObject({ range_m: 9.5 });
  expect(setTarget).toHaveBeenCalledOnce();
  expect(router.latestLocation.search).toEqual({
    machine: "m001",
    mode: "2d",
    range: 8,
    azimuth: 0,
  });
});

test("a page that is being left does not call its address back", async () => {
  const router = opened("/operate");
  await pass(100);
  void router.navigate({ to: "/throws" });
  await pass(1000);
  expect(router.latestLocation.pathname).toBe("/throws");
});
