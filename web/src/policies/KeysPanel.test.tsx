import { MantineProvider } from "@mantine/core";
import { QueryClient, QueryClientProvider } from "@tanstack/react-query";
import { cleanup, render, screen, within } from "@testing-library/react";
import { afterEach, beforeAll, describe, expect, it, vi } from "vitest";
import { api } from "../session/client";
import { stubResizeObserver } from "../testing";
import { localStamp } from "../words/time";
import { KeysPanel, stateWords } from "./KeysPanel";
import type { SiteKey } from "./usePolicyLife";

const MADE = "2026-11-27T09:00:00Z";
const REVOKED = "2026-11-28T05:31:16Z";
const KEY: SiteKey = {
  key_id: "aee8c7cfc9369330",
  public_key: "",
  is_signing: false,
  is_revoked: false,
  since_utc: null,
  made_by: "server",
  revoked_utc: null,
  revoked_by: null,
  approval_count: 0,
  machine_ids: [],
};

function show(answer: () => Promise<unknown>) {
  vi.spyOn(api, "GET").mockImplementation(answer as never);
  const queries = new QueryClient({ defaultOptions: { queries: { retry: false } } });
  render(
    <QueryClientProvider client={queries}>
      <MantineProvider>
        <KeysPanel />
      </MantineProvider>
    </QueryClientProvider>,
  );
}

const cells = (row: HTMLElement) =>
  within(row)
    .getAllByRole("cell")
    .map((cell) => cell.textContent);

beforeAll(stubResizeObserver);
afterEach(() => {
  cleanup();
  vi.restoreAllMocks();
});

describe("the keys of a site", () => {
  it("says of each key its state, who made it, what it signed and who trusts it", async () => {
    const signs = {
      ...KEY,
      key_id: "0f00000000000001",
      is_signing: true,
      since_utc: MADE,
      made_by: "ada",
      approval_count: 4,
      machine_ids: ["m001", "m003"],
    };
    const revoked = { ...KEY, is_revoked: true, revoked_utc: REVOKED, revoked_by: "eve" };
    show(() => Promise.resolve({ data: [signs, revoked], response: new Response() }));
    const first = await screen.findByRole("row", { name: /^0f00000000000001/ });
    expect(cells(first)).toEqual(["Signs", `${localStamp(MADE)} by ada`, "4", "m001, m003"]);
    const second = screen.getByRole("row", { name: /^aee8c7cfc9369330/ });
    const words = `Revoked ${localStamp(REVOKED)} by eve`;
    expect(cells(second)).toEqual([words, "first start by server", "0", "none"]);
    expect(screen.queryByRole("alert")).toBeNull();
  });

  it("gives the server's sentence where the keys cannot be read, and no table", async () => {
    const sentence = "The site's list cannot be read.";
    const error = { error: { code: "approvals", message: sentence } };
    show(() => Promise.resolve({ error, response: new Response(null, { status: 500 }) }));
    expect((await screen.findByRole("alert")).textContent).toBe(sentence);
    expect(screen.queryByRole("table")).toBeNull();
  });

  it("says whether a key signs, is trusted still, or was revoked", () => {
    expect(stateWords({ ...KEY, is_signing: true })).toBe("Signs");
    expect(stateWords(KEY)).toBe("Trusted, signs no more");
    expect(stateWords({ ...KEY, is_revoked: true })).toBe("Revoked");
  });
});
