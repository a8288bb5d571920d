import { MantineProvider } from "@mantine/core";
import { QueryClient, QueryClientProvider } from "@tanstack/react-query";
import { cleanup, render, screen, waitFor } from "@testing-library/react";
import { afterEach, expect, it, vi } from "vitest";
import { api } from "../session/client";
import type { Machine } from "../session/live";
import { LeaseControl } from "./LeaseControl";

afterEach(() => {
  cleanup();
  vi.restoreAllMocks();
});

const FREE = { machine_id: "m001", lamp: "disarmed", lease: { holder: null } } as Machine;

it("lets nobody take control on a page that is not live", async () => {
  vi.spyOn(api, "GET").mockImplementation((() =>
    Promise.resolve({ data: { permissions: ["lease"] }, response: new Response() })) as never);
  const client = new QueryClient();
  const page = (isLive: boolean) => (
    <QueryClientProvider client={client}>
      <MantineProvider>
        <LeaseControl machine={FREE} isLive={isLive} />
      </MantineProvider>
    </QueryClientProvider>
  );
  const { rerender } = render(page(false));
  const take = () => screen.getByRole("button", { name: "Take control" }) as HTMLButtonElement;
  await waitFor(() => expect(take().disabled).toBe(true));
  rerender(page(true));
  expect(take().disabled).toBe(false);
});
