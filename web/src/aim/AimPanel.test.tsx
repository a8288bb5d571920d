import { MantineProvider } from "@mantine/core";
import { QueryClient, QueryClientProvider } from "@tanstack/react-query";
import { cleanup, fireEvent, render, screen, waitFor } from "@testing-library/react";
import { afterEach, beforeAll, expect, it, vi } from "vitest";
import { api } from "../session/client";
import { stubResizeObserver } from "../testing";
import { pointsOf } from "./AimChart";
import { AimPanel } from "./AimPanel";
import type { Aim, AimMode, Proposal } from "./useAim";

const CONTENT = {
  table: { range_m: [7, 8], downrange_m: [0.2, 0.3], crossrange_m: [0, 0] },
  downrange_sd_m: [0.01, 0.02],
  crossrange_sd_m: [0.01, 0.01],
  throw_count: 40,
  before_m: 0.31,
  after_m: 0.07,
  gain_low_m: 0.2,
  gain_high_m: 0.28,
} as Proposal;

const proposed = {
  mode: "2d",
  in_force: null,
  proposal: CONTENT,
  proposal_sha256: "a".repeat(64),
  throw_count: 40,
  problem: "",
} as AimMode;

const version = {
  version_count: 3,
  mode: "2d",
  policy_id: "p7",
  cause: "applied",
  created_by: "eve",
  created_utc: "2026-05-01T10:00:00Z",
  ended_utc: null,
  content: CONTENT,
} as AimMode["in_force"];

const inForce = {
  ...proposed,
  in_force: version,
  proposal: null,
  proposal_sha256: null,
  problem: "40 throws show no bias that a correction would remove.",
} as AimMode;

function open(permissions: string[]) {
  const answer = (data: unknown) => Promise.resolve({ data, response: new Response() });
  const aim = (mode: AimMode) =>
    ({ machine_id: "m001", modes: [mode], history: mode.in_force ? [mode.in_force] : [] }) as Aim;
  vi.spyOn(api, "GET").mockImplementation(((path: string) =>
    answer(path === "/api/v1/auth/me" ? { permissions } : aim(proposed))) as never);
  const post = vi
    .spyOn(api, "POST")
    .mockImplementation(((path: string) =>
      answer(aim(path.endsWith("/undo") ? proposed : inForce))) as never);
  render(
    <QueryClientProvider client={new QueryClient()}>
      <MantineProvider>
        <AimPanel machineId="m001" />
      </MantineProvider>
    </QueryClientProvider>,
  );
  return post;
}

const button = (name: string) => screen.findByRole<HTMLButtonElement>("button", { name });

beforeAll(stubResizeObserver);
afterEach(() => {
  cleanup();
  vi.restoreAllMocks();
});

it("says what is gained, applies what is shown, lists it, and undoes it", async () => {
  const post = open(["aim.apply"]);
  await screen.findByText(/goes from 0.31 m to 0.07 m \(gain 0.20 to 0.28 m, 90 %\)/);
  await waitFor(async () => expect((await button("Apply the correction")).disabled).toBe(false));
  fireEvent.click(await button("Apply the correction"));
  await screen.findByText(/Correction v3 is in force.*no bias that a correction would remove/);
  expect(post.mock.calls[0]?.[1]).toMatchObject({ body: { proposal_sha256: "a".repeat(64) } });
  expect(screen.getByRole("list", { name: /Versions/ }).textContent).toMatch(/v3 by eve.*in force/);
  fireEvent.click(await button("Undo v3"));
  await screen.findByText(/No correction is in force/);
});

it("lets only those apply it who may", async () => {
  open([]);
  expect((await button("Apply the correction")).disabled).toBe(true);
});

it("draws 90 % intervals", () => {
  expect(pointsOf(CONTENT, "downrange")[1]).toEqual({
    range_m: 8,
    miss_m: 0.3,
    half_m: 1.645 * 0.02,
  });
});
