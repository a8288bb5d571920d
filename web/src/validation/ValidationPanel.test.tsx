import { MantineProvider } from "@mantine/core";
import { QueryClient, QueryClientProvider } from "@tanstack/react-query";
import { cleanup, fireEvent, render, screen, waitFor } from "@testing-library/react";
import { afterEach, beforeAll, describe, expect, it, vi } from "vitest";
import { api, type Schema } from "../session/client";
import { stubResizeObserver } from "../testing";
import { ValidationPanel } from "./ValidationPanel";

const POLICY = {
  policy_id: "m545-2d-v8",
  policy_sha256: "a".repeat(64),
  is_present: true,
} as Schema["PolicyView"];

const OPEN = {
  validation_id: "v1",
  state: "running",
  progress_ratio: 0.4,
  step: "m545-2d-v8 with virtual machine 0",
  created_by: "eve",
  created_utc: "2026-11-27T09:00:00Z",
  is_passed: null,
  result: null,
};
let asked: unknown[] = [];

function serve(newest: unknown, permissions = ["policy.validate"]) {
  const answer = (data: unknown) => Promise.resolve({ data, response: new Response() });
  vi.spyOn(api, "GET").mockImplementation(((path: string) =>
    answer(
      path.endsWith("/auth/me")
        ? { permissions }
        : typeof newest === "function"
          ? newest()
          : newest,
    )) as never);
  for (const method of ["POST", "DELETE"] as const)
    vi.spyOn(api, method).mockImplementation(((path: string, options: unknown) => {
      asked.push([method, path, options]);
      return answer({});
    }) as never);
  const client = new QueryClient();
  render(
    <QueryClientProvider client={client}>
      <MantineProvider>
        <ValidationPanel policy={POLICY} />
      </MantineProvider>
    </QueryClientProvider>,
  );
  return client;
}

beforeAll(stubResizeObserver);
afterEach(() => {
  cleanup();
  vi.restoreAllMocks();
  asked = [];
});

describe("validation of a version", () => {
  it("starts with the throws that were chosen", async () => {
    serve(null);
    fireEvent.click(await screen.findByRole("button", { name: "Validate m545-2d-v8" }));
    fireEvent.change(await screen.findByLabelText("Throws at each target"), {
      target: { value: "2" },
    });
    fireEvent.click(screen.getByRole("button", { name: "Validate" }));
    await waitFor(() => expect(asked).toHaveLength(1));
    expect(asked[0]).toMatchObject([
      "POST",
      "/api/v1/policies/{policy_sha256}/validation",
      { body: { protocol: "short", throws_per_target: 2, unseen_unit_count: 2 } },
    ]);
  });

  it("asks for the versions again when it ends, for it changes their state", async () => {
    let newest: unknown = OPEN;
    const client = serve(() => newest);
    const renewed = vi.spyOn(client, "invalidateQueries");
    await screen.findByText(/with virtual machine 0, 40 %/);
    expect(renewed).not.toHaveBeenCalled();
    newest = null;
    await waitFor(() => expect(renewed).toHaveBeenCalledWith({ queryKey: ["policies"] }), {
      timeout: 4_000,
    });
  });

  it("shows progress and cancels by one press", async () => {
    serve(OPEN);
    expect(await screen.findByText(/with virtual machine 0, 40 %/)).toBeTruthy();
    fireEvent.click(
      await screen.findByRole("button", { name: "Cancel the validation of m545-2d-v8" }),
    );
    await waitFor(() => expect(asked).toHaveLength(1));
    expect(asked[0]).toEqual([
      "DELETE",
      "/api/v1/policies/{policy_sha256}/validation",
      { params: { path: { policy_sha256: POLICY.policy_sha256 } } },
    ]);
  });

  it("offers nothing to a role that may only look", async () => {
    serve(null, ["view"]);
    expect(await screen.findByText("Not validated yet.")).toBeTruthy();
    expect(screen.queryByRole("button")).toBeNull();
  });
});
