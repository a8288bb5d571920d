import { MantineProvider } from "@mantine/core";
import { QueryClient, QueryClientProvider } from "@tanstack/react-query";
import { cleanup, fireEvent, render, screen, waitFor } from "@testing-library/react";
import { afterEach, beforeAll, beforeEach, describe, expect, it, vi } from "vitest";
import { api } from "../session/client";
import type { Machine } from "../session/live";
import { stubResizeObserver } from "../testing";
import { ClearStop } from "./ClearStop";

const posted: unknown[] = [];
const onClose = vi.fn();

const machine = (latch_id: string, latched_reason: string) =>
  ({ machine_id: "m001", state: { latch_id, latched_reason } }) as unknown as Machine;

const page = (shown: Machine) => (
  <QueryClientProvider client={new QueryClient()}>
    <MantineProvider env="test">
      <ClearStop machine={shown} onClose={onClose} />
    </MantineProvider>
  </QueryClientProvider>
);

const button = () => screen.getByRole("button", { name: "Clear" });
const see = () => fireEvent.click(screen.getByRole("checkbox"));
const say = (reason: string) =>
  fireEvent.change(screen.getByRole("textbox"), { target: { value: reason } });

beforeAll(stubResizeObserver);
beforeEach(() => {
  posted.length = 0;
  onClose.mockReset();
  const answer = (data: unknown) => Promise.resolve({ data, response: new Response() });
  vi.spyOn(api, "GET").mockImplementation((() => answer({ username: "sue" })) as never);
  vi.spyOn(api, "POST").mockImplementation(((_: string, options: { body: unknown }) => {
    posted.push(options.body);
    return answer({});
  }) as never);
});
afterEach(cleanup);

describe("clearing a stop", () => {
  it("needs sight of the machine and a reason, and names the latch", async () => {
    render(page(machine("b.1", "STOP by vic")));
    expect(screen.getByText("STOP by vic")).toBeTruthy();
    expect(button()).toHaveProperty("disabled", true);
    see();
    expect(button()).toHaveProperty("disabled", true);
    say("  ");
    expect(button()).toHaveProperty("disabled", true);
    say("nobody near");
    fireEvent.click(button());
    await waitFor(() => expect(onClose).toHaveBeenCalled());
    expect(posted).toEqual([{ latch_id: "b.1", is_sighted: true, reason: "nobody near" }]);
  });

  it("asks to look again when another stop comes meanwhile", async () => {
    const { rerender } = render(page(machine("b.1", "STOP by vic")));
    see();
    say("nobody near");
    rerender(page(machine("b.2", "the emergency stop is pressed")));
    expect(screen.getByRole("alert").textContent).toMatch(/stopped again/);
    expect(screen.queryByRole("button", { name: "Clear" })).toBeNull();
    fireEvent.click(screen.getByRole("button", { name: /read the new reason/ }));
    expect(button()).toHaveProperty("disabled", true);
    see();
    fireEvent.click(button());
    await waitFor(() => expect(posted).toHaveLength(1));
    expect(posted[0]).toMatchObject({ latch_id: "b.2" });
  });

  it("shows why the server or the machine refuses, and stays open", async () => {
    const error = { code: "latch_changed", message: "m001 was stopped again.", detail: null };
    vi.spyOn(api, "POST").mockImplementation((() =>
      Promise.resolve({
        error: { error },
        response: new Response(null, { status: 409 }),
      })) as never);
    render(page(machine("b.1", "STOP by vic")));
    see();
    say("nobody near");
    fireEvent.click(button());
    expect((await screen.findByRole("alert")).textContent).toMatch(/stopped again/);
    expect(onClose).not.toHaveBeenCalled();
  });
});
