import { MantineProvider } from "@mantine/core";
import { QueryClient, QueryClientProvider } from "@tanstack/react-query";
import { cleanup, fireEvent, render, screen, waitFor } from "@testing-library/react";
import { afterEach, beforeAll, describe, expect, it, vi } from "vitest";
import { api, type Schema } from "../session/client";
import { stubResizeObserver } from "../testing";
import { RolloutPanel } from "./RolloutPanel";
import type { Rollout } from "./useRollouts";

const AT = "2026-11-27T09:00:00Z";
const POLICY = {
  policy_id: "v8",
  policy_sha256: "a".repeat(64),
  mode: "2d",
  state: "approved",
  is_present: true,
} as Schema["PolicyView"];
const PAUSED = {
  rollout_id: "r1",
  mode: "2d",
  policy_id: "v8",
  policy_sha256: POLICY.policy_sha256,
  state: "paused",
  stage_count: 0,
  stages: [
    { name: "m001", machine_ids: ["m001"] },
    { name: "tag yard", machine_ids: ["m002"] },
  ],
  machines: [
    {
      machine_id: "m001",
      stage_count: 0,
      state: "error",
      sentence: "m001 refused it: not signed.",
      failed_count: 0,
      before_policy_id: "v7",
      before: null,
      since: null,
    },
  ],
  steps: [
    { state: "running", stage_count: 0, actor: "eve", sentence: "retrained", at_utc: AT },
    { state: "paused", stage_count: 0, actor: "server", sentence: "m001 refused it.", at_utc: AT },
  ],
  reason: "retrained",
  throws_count: 12,
  deadline_s: 600,
  false_alarm_ratio: 0.01,
  created_by: "eve",
  created_utc: AT,
} as unknown as Rollout;
let posted: unknown[] = [];

function serve(rollouts: Rollout[], permissions = ["policy.deploy"]) {
  const answer = (data: unknown) => Promise.resolve({ data, response: new Response() });
  vi.spyOn(api, "GET").mockImplementation(((path: string) =>
    answer(path === "/api/v1/auth/me" ? { permissions } : rollouts)) as never);
  vi.spyOn(api, "POST").mockImplementation(((path: string, options: unknown) => {
    posted.push([path, options]);
    return answer({});
  }) as never);
  render(
    <QueryClientProvider client={new QueryClient()}>
      <MantineProvider>
        <RolloutPanel policies={[POLICY]} />
      </MantineProvider>
    </QueryClientProvider>,
  );
}

const button = (name: RegExp | string) =>
  screen.findByRole("button", { name }) as Promise<HTMLButtonElement>;

beforeAll(stubResizeObserver);
afterEach(() => {
  cleanup();
  vi.restoreAllMocks();
  posted = [];
});

describe("rollouts", () => {
  it("starts one with stages and a reason", async () => {
    serve([]);
    expect(await screen.findByText(/No rollout is open/)).toBeTruthy();
    await waitFor(async () => expect((await button("Start a rollout")).disabled).toBe(false));
    fireEvent.click(await button("Start a rollout"));
    fireEvent.change(await screen.findByLabelText(/Why/), { target: { value: "retrained" } });
    const go = await button("Start the rollout");
    expect(go.disabled).toBe(true);
    fireEvent.change(screen.getByLabelText(/Stages/), { target: { value: "m001\ntag:yard" } });
    fireEvent.click(go);
    await waitFor(() => expect(posted).toHaveLength(1));
    expect(posted[0]).toEqual([
      "/api/v1/policy-rollouts/{mode}/start",
      {
        params: { path: { mode: "2d" } },
        body: {
          policy_sha256: POLICY.policy_sha256,
          reason: "retrained",
          stages: [
            { machine_ids: ["m001"], tags: [] },
            { machine_ids: [], tags: ["yard"] },
          ],
          throws_count: 12,
          deadline_s: 600,
        },
      },
    ]);
  });

  it("says why it is paused and what an abort does", async () => {
    serve([PAUSED]);
    expect((await screen.findByRole("status")).textContent).toBe("m001 refused it.");
    expect(screen.getByRole("row", { name: /m001/ }).textContent).toContain("not signed");
    fireEvent.click(await button("Abort: rollout of v8 in 2D"));
    expect(await screen.findByText(/goes back to the version before/)).toBeTruthy();
    fireEvent.change(screen.getByLabelText(/Why/), { target: { value: "another day" } });
    fireEvent.click(await button("Abort"));
    await waitFor(() => expect(posted).toHaveLength(1));
    expect(posted[0]).toEqual([
      "/api/v1/policy-rollouts/{rollout_id}/change/{change}",
      {
        params: { path: { rollout_id: "r1", change: "abort" } },
        body: { reason: "another day" },
      },
    ]);
  });

  it("offers no change to those who may only look", async () => {
    serve([PAUSED], []);
    await screen.findByText("Your role may look, not deploy.");
    expect((await button("Start a rollout")).disabled).toBe(true);
    expect(screen.queryByRole("button", { name: /Abort/ })).toBeNull();
  });
});
