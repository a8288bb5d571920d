import { MantineProvider } from "@mantine/core";
import { QueryClient, QueryClientProvider } from "@tanstack/react-query";
import { cleanup, fireEvent, render, screen, waitFor, within } from "@testing-library/react";
import { afterEach, beforeAll, describe, expect, it, vi } from "vitest";
import { api } from "../../session/client";
import { stubResizeObserver } from "../../testing";
import { StartPanel } from "./StartPanel";

const TICKED = "Healthy throws to compare with, newest first";
let posted: unknown[] = [];

const ENOUGH = { is_used: true, words: "24 reference throws of 2026-05-01 and 2026-05-02." };
const FEW = { is_used: false, words: "6 reference throws of 2026-05-01. 6 are too few." };

/** A server with so many throws on 20 November, and four on the day before. */
function serve(count: number, kept: typeof ENOUGH) {
  const row = (index: number, day: number) => ({
    throw_id: `d${day}-${index}`,
    created_utc: `2026-11-${day}T10:${String(59 - index).padStart(2, "0")}:00Z`,
    mode: "3d",
    target: { range_m: 8 },
    measured_downrange_error_m: 0.1,
    has_log: true,
  });
  const newer = Array.from({ length: count }, (_, index) => row(index, 20));
  const older = Array.from({ length: 4 }, (_, index) => row(index, 10));
  const answer = (data: unknown) => Promise.resolve({ data, response: new Response() });
  vi.spyOn(api, "GET").mockImplementation(((path: string, options: Asked) => {
    if (path === "/api/v1/auth/me") return answer({ permissions: ["gap.run"] });
    if (path.endsWith("/kept-reference")) return answer(kept);
    const rows = options.params.query.until ? older : [...newer, ...older].slice(0, 60);
    return answer({ rows, next_cursor: null });
  }) as never);
  vi.spyOn(api, "POST").mockImplementation(((_path: string, options: { body: unknown }) => {
    posted.push(options.body);
    return answer({ gap_run_id: "g1" });
  }) as never);
}

type Asked = { params: { query: { until?: string } } };

async function open(count: number, kept = ENOUGH) {
  serve(count, kept);
  render(
    <QueryClientProvider client={new QueryClient()}>
      <MantineProvider>
        <StartPanel machineId="m001" onStarted={vi.fn()} />
      </MantineProvider>
    </QueryClientProvider>,
  );
  await screen.findByText(/throws of this machine landed/);
}

const start = () => screen.getByRole("button", { name: "Start diagnosis" }) as HTMLButtonElement;
const compare = (label: string) => fireEvent.click(screen.getByRole("radio", { name: label }));
const boxes = () => within(screen.getByRole("table", { name: TICKED })).getAllByRole("checkbox");

beforeAll(stubResizeObserver);
afterEach(() => {
  cleanup();
  vi.restoreAllMocks();
  posted = [];
});

describe("a new diagnosis", () => {
  it("compares with kept reference throws by default, and names their days", async () => {
    await open(12);
    expect(screen.getByText(/24 reference throws of 2026-05-01 and 2026-05-02/)).toBeTruthy();
    expect(screen.queryByRole("table", { name: TICKED })).toBeNull();
    fireEvent.click(start());
    await waitFor(() => expect(posted).toEqual([{ newest_count: 12, mode: null }]));
  });

  it("asks for the least move of the impact that matters", async () => {
    await open(12);
    const field = screen.getByLabelText("Least move of the impact");
    fireEvent.change(field, { target: { value: "5" } });
    expect(screen.getByText(/less than 5 cm is seen, not named/)).toBeTruthy();
    fireEvent.click(start());
    await waitFor(() =>
      expect(posted).toEqual([{ newest_count: 12, mode: null, material_m: 0.05 }]),
    );
  });

  it("says when too few are kept, and what that means", async () => {
    await open(12, FEW);
    expect(screen.getByText(/6 are too few. It is compared with its type/)).toBeTruthy();
  });

  it("compares with the machine type when asked", async () => {
    await open(12);
    compare("Machine type");
    expect(screen.getByText(/small effects stay hidden/)).toBeTruthy();
    fireEvent.click(start());
    await waitFor(() =>
      expect(posted).toEqual([{ newest_count: 12, mode: null, against: "type" }]),
    );
  });

  it("offers healthy throws that are not diagnosed, and asks for three", async () => {
    await open(12);
    compare("This machine");
    await screen.findByRole("table", { name: TICKED });
    expect(boxes()).toHaveLength(1 + 4);
    expect(start().disabled).toBe(true);
    expect(screen.getByText("0 healthy throws chosen, at least 3.")).toBeTruthy();
    for (const box of boxes().slice(1, 4)) fireEvent.click(box);
    expect(screen.getByText("3 healthy throws ticked.")).toBeTruthy();
    fireEvent.click(start());
    await waitFor(() =>
      expect(posted).toEqual([
        { newest_count: 12, mode: null, reference_throw_ids: ["d10-0", "d10-1", "d10-2"] },
      ]),
    );
  });

  it("keeps what was ticked when another day is listed", async () => {
    await open(14);
    compare("This machine");
    await screen.findByRole("table", { name: TICKED });
    fireEvent.click(boxes()[1] as HTMLElement);
    const day = screen.getByLabelText("Healthy throws up to");
    fireEvent.change(day, { target: { value: "2026-11-10" } });
    await waitFor(() => expect(boxes()).toHaveLength(1 + 4));
    fireEvent.click(boxes()[0] as HTMLElement);
    expect(screen.getByText("5 healthy throws ticked.")).toBeTruthy();
    fireEvent.click(boxes()[0] as HTMLElement);
    expect(screen.getByText("1 healthy throw ticked.")).toBeTruthy();
  });

  it("says what to do when there are no others", async () => {
    await open(8);
    compare("This machine");
    expect(await screen.findByText(/No other throws with a log. Record some/)).toBeTruthy();
    expect(start().disabled).toBe(true);
    compare("Machine type");
    expect(start().disabled).toBe(false);
  });
});
