import { MantineProvider } from "@mantine/core";
import { cleanup, fireEvent, render, screen } from "@testing-library/react";
import { afterEach, beforeAll, describe, expect, it, vi } from "vitest";
import { ApiError } from "../session/client";
import { stubResizeObserver } from "../testing";
import type { Job } from "./job";
import { NextLoads } from "./NextLoads";
import type { JobChange, useJobChange } from "./useJobs";

vi.mock("@tanstack/react-router", () => ({
  Link: ({ children, search, to }: { children: React.ReactNode; search: object; to: string }) => (
    <a href={to} data-search={JSON.stringify(search)}>
      {children}
    </a>
  ),
}));

const proposal = (proposal_count: number) => ({
  proposal_count,
  mode: "3d",
  pace_ratio: 0.5,
  x_m: 8,
  y_m: 6,
  z_m: 1.2,
  surface_m: 1.3,
  volume_m3: 0.25,
  spill_ratio: 0.004,
  sentence: `load ${proposal_count}: 0.30 m3 missing`,
});
const JOB = {
  machine_id: "m001",
  plan_state: "ready",
  plan_error: null,
  landing_by: "predicted",
  next: [proposal(1), proposal(2)],
} as unknown as Job;

type Shown = {
  job?: Partial<Job>;
  mayEdit?: boolean;
  moving?: number | null;
  failed?: { variables: JobChange; error: ApiError };
};

function show({ job = {}, mayEdit = true, moving = null, failed }: Shown = {}) {
  const mutate = vi.fn();
  const change = { mutate, isError: failed !== undefined, isPending: false, ...failed };
  render(
    <MantineProvider>
      <NextLoads
        job={{ ...JOB, ...job }}
        mayEdit={mayEdit}
        change={change as unknown as ReturnType<typeof useJobChange>}
        moving={moving}
        onMoving={() => undefined}
      />
    </MantineProvider>,
  );
  return mutate;
}

beforeAll(stubResizeObserver);
afterEach(cleanup);

describe("the next loads", () => {
  it("are aimed at in Operate, with mode, pace, place and height", () => {
    show();
    const aim = screen.getAllByText("Aim")[1]?.closest("a");
    expect(JSON.parse(aim?.dataset.search ?? "")).toEqual({
      machine: "m001",
      mode: "3d",
      pace: 0.5,
      range: 10,
      azimuth: 36.87,
      height: 1.2,
    });
    expect(screen.getAllByText(/3D, balanced/)).toHaveLength(2);
  });

  it("are skipped, and moved to the place that was typed", () => {
    const mutate = show({ moving: 2 });
    fireEvent.click(screen.getByRole("button", { name: "Skip load 1" }));
    expect(mutate.mock.calls[0]?.[0]).toEqual({ kind: "skip", body: { proposal_count: 1 } });
    fireEvent.change(screen.getByLabelText("x, m"), { target: { value: "7.5" } });
    fireEvent.click(screen.getByRole("button", { name: "Put it there" }));
    expect(mutate.mock.calls[1]?.[0]).toEqual({
      kind: "move",
      body: { proposal_count: 2, x_m: 7.5, y_m: 6 },
    });
  });

  it("say beside the one concerned why it was refused", () => {
    const body = { proposal_count: 2, x_m: 20, y_m: 0 };
    const error = new ApiError(422, "job_refused", "It lies beside the truck.");
    show({ failed: { variables: { kind: "move", body }, error } });
    const item = screen.getByRole("alert").closest("li");
    expect(item?.dataset.proposal).toBe("2");
    expect(item?.textContent).toContain("beside the truck");
  });

  it("are only looked at without the right to throw", () => {
    show({ mayEdit: false });
    expect(screen.queryByRole("button")).toBeNull();
    expect(screen.queryByText("Aim")).toBeNull();
    expect(screen.getByText(/Your role may look/)).toBeTruthy();
  });

  it("tell while they are planned, and why there are none", () => {
    show({ job: { plan_state: "planning", next: [] } });
    expect(screen.getByText("Planning the next loads…")).toBeTruthy();
    cleanup();
    show({ job: { plan_state: "failed", plan_error: "the truck is out of reach", next: [] } });
    expect(screen.getByRole("status").textContent).toMatch(/^The truck is out of reach\. Upload/);
  });
});
