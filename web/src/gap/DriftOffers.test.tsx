import { MantineProvider } from "@mantine/core";
import { QueryClient, QueryClientProvider } from "@tanstack/react-query";
import { cleanup, fireEvent, render, screen, waitFor } from "@testing-library/react";
import { afterEach, expect, it, vi } from "vitest";
import type { Alert } from "../alerts/attention";
import { api } from "../session/client";
import { DriftOffers } from "./DriftOffers";

const went = vi.fn();
vi.mock("@tanstack/react-router", () => ({
  useNavigate: () => went,
  Link: ({ children, search }: { children: string; search: { run: string } }) => (
    <a href={`/gap?run=${search.run}`}>{children}</a>
  ),
}));

const DRIFT = {
  mode: "2d",
  diagnosed_throw_count: 12,
  reference_throw_count: 24,
  problem: "",
  gap_run_id: null as string | null,
};

function open(drift: typeof DRIFT) {
  const answer = (data: unknown) => Promise.resolve({ data, response: new Response() });
  vi.spyOn(api, "GET").mockImplementation(((path: string) =>
    answer(path === "/api/v1/auth/me" ? { permissions: ["gap.run"] } : [drift])) as never);
  const post = vi
    .spyOn(api, "POST")
    .mockImplementation((() => answer({ gap_run_id: "g1" })) as never);
  render(
    <QueryClientProvider client={new QueryClient()}>
      <MantineProvider>
        <DriftOffers alert={{ machine_id: "m007", text: "drift" } as Alert} />
      </MantineProvider>
    </QueryClientProvider>,
  );
  return post;
}

const button = () => screen.findByRole<HTMLButtonElement>("button", { name: /Diagnose the 2D/ });

afterEach(() => {
  cleanup();
  vi.restoreAllMocks();
  localStorage.clear();
});

it("says what is compared, starts it with one press, and opens it for the alert's machine", async () => {
  const post = open(DRIFT);
  await screen.findByText("12 throws since the change against 24 of before");
  await waitFor(async () => expect((await button()).disabled).toBe(false));
  fireEvent.click(await button());
  await waitFor(() => expect(went).toHaveBeenCalledWith({ to: "/gap", search: { run: "g1" } }));
  expect(post.mock.calls[0]?.[1]).toEqual({
    params: { path: { machine_id: "m007", mode: "2d" } },
  });
  expect(localStorage.getItem("downrange.machine")).toBe('"m007"');
});

it("leads to the diagnosis that there is", async () => {
  open({ ...DRIFT, gap_run_id: "g7" });
  const link = await screen.findByRole("link", { name: "Diagnosis of the 2D drift" });
  expect(link.getAttribute("href")).toBe("/gap?run=g7");
});

it("says why it cannot be started yet", async () => {
  open({ ...DRIFT, problem: "2 throws since the change. Throw more." });
  await screen.findByText("2 throws since the change. Throw more.");
  await waitFor(async () => expect((await button()).disabled).toBe(true));
});
