import { MantineProvider } from "@mantine/core";
import { QueryClient, QueryClientProvider } from "@tanstack/react-query";
import { cleanup, fireEvent, render, screen, waitFor } from "@testing-library/react";
import { afterEach, beforeAll, describe, expect, it, vi } from "vitest";
import { api } from "../session/client";
import { stubResizeObserver } from "../testing";
import { chooseZone } from "../words/zone";
import { OnBoard } from "./OnBoard";

const SINCE = "2026-11-27T09:00:00Z";
const NEW = { mode: "2d", policy_sha256: "a".repeat(64), policy_id: "v8", since_utc: SINCE };
const OLD = { ...NEW, policy_sha256: "b".repeat(64), policy_id: "v7" };
let posted: unknown[] = [];
let deployments: unknown[] = [];
let onBoard = NEW;
let rolledBack: string | null = null;

type Asked = { params: { query?: { at?: string } } };

/** A machine with v8 on board since nine; before that `earlier`. */
function serve(earlier: (typeof OLD)[], permissions = ["policy.deploy"]) {
  const answer = (data: unknown) => Promise.resolve({ data, response: new Response() });
  vi.spyOn(api, "GET").mockImplementation(((path: string, options: Asked) => {
    if (path === "/api/v1/auth/me") return answer({ permissions });
    if (path.endsWith("/deployments")) return answer(deployments);
    const at = options.params.query?.at;
    const isBefore = at !== undefined && Date.parse(at) < Date.parse(SINCE);
    const back = { version_before: earlier[0]?.policy_id ?? null, rolled_back_from: rolledBack };
    const now = [{ ...onBoard, ...back }];
    return answer({ machine_id: "m001", at_utc: SINCE, policies: isBefore ? earlier : now });
  }) as never);
  vi.spyOn(api, "POST").mockImplementation(((path: string, options: unknown) => {
    posted.push([path, options]);
    return answer({});
  }) as never);
  const client = new QueryClient();
  render(
    <QueryClientProvider client={client}>
      <MantineProvider>
        <OnBoard machineId="m001" />
      </MantineProvider>
    </QueryClientProvider>,
  );
  return client;
}

const rollBack = () =>
  screen.findByRole("button", { name: "Roll back 2D of m001" }) as Promise<HTMLButtonElement>;

beforeAll(stubResizeObserver);
afterEach(() => {
  cleanup();
  vi.restoreAllMocks();
  vi.useRealTimers();
  posted = [];
  deployments = [];
  onBoard = NEW;
  rolledBack = null;
  chooseZone("");
});

describe("what a machine has on board", () => {
  it("rolls back with the consequence and a reason", async () => {
    serve([OLD]);
    await waitFor(async () => expect((await rollBack()).disabled).toBe(false));
    fireEvent.click(await rollBack());
    expect(await screen.findByText(/throws in 2D with v7 again instead of v8/)).toBeTruthy();
    const go = screen.getByRole("button", { name: "Go back to v7" }) as HTMLButtonElement;
    expect(go.disabled).toBe(true);
    fireEvent.change(screen.getByLabelText(/Why/), { target: { value: "wider on m001" } });
    fireEvent.click(go);
    await waitFor(() => expect(posted).toHaveLength(1));
    expect(posted[0]).toEqual([
      "/api/v1/machines/{machine_id}/policies/{mode}/rollback",
      { params: { path: { machine_id: "m001", mode: "2d" } }, body: { reason: "wider on m001" } },
    ]);
  });

  it("keeps the focus at the machine's row, although its button is off then", async () => {
    serve([OLD]);
    await waitFor(async () => expect((await rollBack()).disabled).toBe(false));
    const open = async () => {
      (await rollBack()).focus();
      fireEvent.click(await rollBack());
      return (await screen.findByLabelText(/Why/)) as HTMLInputElement;
    };
    fireEvent.keyDown(await open(), { key: "Escape" });
    await waitFor(async () => expect(document.activeElement).toBe(await rollBack()));
    fireEvent.change(await open(), { target: { value: "wider on m001" } });
    const wish = { ...OLD, deployment_count: 1, created_utc: SINCE, created_by: "ada" };
    const asked = { ...wish, is_rollback: true, reason: "wider", detail: "" };
    deployments = [{ ...asked, outcome: "pending", ended_utc: null }];
    fireEvent.click(screen.getByRole("button", { name: "Go back to v7" }));
    await screen.findByText(/Goes back to v7/);
    const row = screen.getByText("2D", { selector: "li > span" }).parentElement;
    await waitFor(() => expect(document.activeElement).toBe(row));
    expect((await rollBack()).disabled).toBe(true);
  });

  it("offers no way back where there was no other version", async () => {
    serve([]);
    expect(await screen.findByText("No earlier version.")).toBeTruthy();
    expect((await rollBack()).disabled).toBe(true);
  });

  it("offers no way back to a version that was rolled back, and says so", async () => {
    rolledBack = "v9";
    serve([]);
    expect(
      await screen.findByText(/No version before v8: v9 was rolled back\. Deploy it/),
    ).toBeTruthy();
    expect((await rollBack()).disabled).toBe(true);
  });

  it("reads a time in the zone that the person chose", async () => {
    chooseZone("Asia/Kolkata");
    serve([OLD]);
    await screen.findByText("v8");
    const field = screen.getByLabelText("What ran on m001 at (GMT+5:30)");
    fireEvent.change(field, { target: { value: "2026-11-27T14:29:59" } });
    await waitFor(() => expect(screen.getByTestId("had-at").textContent).toBe("2D: v7"));
    fireEvent.change(field, { target: { value: "2026-11-27T14:30:00" } });
    await waitFor(() => expect(screen.getByTestId("had-at").textContent).toBe("2D: v8"));
  });

  it("shows another version as soon as the machine has switched to it", async () => {
    // No polling: what is shown comes of the machine's answer alone.
    vi.useFakeTimers({ toFake: ["setInterval"] });
    const wish = { ...NEW, deployment_count: 1, created_utc: SINCE, created_by: "ada" };
    const asked = { ...wish, policy_id: "v9", is_rollback: false, reason: "try", detail: "" };
    deployments = [{ ...asked, outcome: "pending", ended_utc: null }];
    const client = serve([OLD]);
    await screen.findByText(/Switches to v9/);
    onBoard = { ...NEW, policy_id: "v9" };
    deployments = [{ ...asked, outcome: "switched", ended_utc: SINCE }];
    await client.invalidateQueries({ queryKey: ["deployments"] });
    await screen.findByText("v9", { selector: "strong" });
    expect(screen.queryByText(/Switches to v9/)).toBeNull();
  });

  it("tells what ran at a time", async () => {
    serve([OLD]);
    await screen.findByText("v8");
    const field = screen.getByLabelText(/What ran on m001 at/);
    fireEvent.change(field, { target: { value: "2026-11-20T10:14:00" } });
    await waitFor(() => expect(screen.getByTestId("had-at").textContent).toBe("2D: v7"));
  });
});
