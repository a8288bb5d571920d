import { MantineProvider } from "@mantine/core";
import { QueryClient, QueryClientProvider } from "@tanstack/react-query";
import { cleanup, fireEvent, render, screen, waitFor } from "@testing-library/react";
import { useState } from "react";
import { afterEach, beforeAll, beforeEach, describe, expect, it, vi } from "vitest";
import { api } from "../session/client";
import type { Machine } from "../session/live";
import { stubResizeObserver } from "../testing";
import { ZonePanel } from "./ZonePanel";
import { type Drawing, newZone, type Zone, type Zones } from "./zones";

const OFFICE = {
  ...newZone(
    [
      [5, 1],
      [7, 1],
      [6, 3],
    ],
    [],
  ),
  name: "Office",
  reason: "people",
};
const MACHINE = { machine_id: "m001", state: { zones_sha256: "" } } as unknown as Machine;
const calls: [string, unknown][] = [];
let permissions: string[] = [];

const view = (changes: Partial<Zones>): Zones => ({
  machine_id: "m001",
  version_count: 4,
  zones: [OFFICE],
  is_approved: true,
  approved: [OFFICE],
  approved_version_count: 4,
  approved_sha256: "s",
  reason: "the yard's plan",
  changed_by: "ada",
  changed_utc: "2026-11-27T10:00:00Z",
  approved_by: "sue",
  approved_utc: "2026-11-27T10:00:00Z",
  undo_version_count: null,
  drawn_by: [],
  is_four_eyes: true,
  ...changes,
});

function Page({ zones, first = null }: { zones: Zones; first?: Drawing | null }) {
  const [drawing, setDrawing] = useState<Drawing | null>(first);
  const [draft, setDraft] = useState<Zone[] | null>(null);
  const [open, setOpen] = useState<number | null>(null);
  return (
    <QueryClientProvider client={new QueryClient()}>
      <MantineProvider env="test">
        <ZonePanel
          machine={MACHINE}
          zones={zones}
          drawing={drawing}
          onDrawing={setDrawing}
          draft={draft}
          onDraft={setDraft}
          open={open}
          onOpen={setOpen}
        />
      </MantineProvider>
    </QueryClientProvider>
  );
}

const press = (name: string | RegExp) => fireEvent.click(screen.getByRole("button", { name }));
const type = (label: string | RegExp, value: string) =>
  fireEvent.change(screen.getByLabelText(label), { target: { value } });

beforeAll(stubResizeObserver);
beforeEach(() => {
  calls.length = 0;
  permissions = ["site.edit", "zones.approve"];
  const answer = (data: unknown) => Promise.resolve({ data, response: new Response() });
  vi.spyOn(api, "GET").mockImplementation((() =>
    answer({ username: "sue", permissions })) as never);
  const note = ((path: string, options: { body: unknown }) => {
    calls.push([path.split("/").at(-1) ?? "", options.body]);
    return answer(view({}));
  }) as never;
  vi.spyOn(api, "PUT").mockImplementation(note);
  vi.spyOn(api, "POST").mockImplementation(note);
});
afterEach(cleanup);

describe("the panel of exclusion zones", () => {
  it("makes a zone of what was drawn, and saves it as a draft with a reason", async () => {
    const corners: Drawing["corners"] = [
      [1, 1],
      [4, 1],
      [3, 3],
    ];
    render(<Page zones={view({})} first={{ tool: "polygon", corners }} />);
    press("Finish");
    type(/What is there/, "a shed");
    type("To, m", "2.5");
    type(/Why it is changed/, "it was built");
    press("Save draft");
    await waitFor(() => expect(calls).toHaveLength(1));
    expect(calls[0]).toEqual([
      "zones",
      {
        zones: [
          OFFICE,
          { name: "zone 1", reason: "a shed", corners_m: corners, bottom_m: 0, top_m: 2.5 },
        ],
        from_version_count: 4,
        reason: "it was built",
      },
    ]);
  });

  it("moves corners by keyboard and keeps at least three", async () => {
    render(<Page zones={view({})} />);
    await waitFor(() =>
      expect(screen.getByRole("button", { name: "Delete Office" })).toHaveProperty(
        "disabled",
        false,
      ),
    );
    press(/^zone Office/);
    expect(screen.getByRole("button", { name: "Delete corner 1" })).toHaveProperty(
      "disabled",
      true,
    );
    type("x 1, m", "5.5");
    press("Add corner");
    press("Delete corner 2");
    press("Delete Office");
    expect(screen.queryByText("Office")).toBeNull();
  });

  it("lets the right person approve a draft", async () => {
    render(<Page zones={view({ is_approved: false, approved: [], approved_version_count: 0 })} />);
    await waitFor(() =>
      expect(screen.getByRole("button", { name: /Approve/ })).toHaveProperty("disabled", false),
    );
    press("Approve version 4");
    await waitFor(() => expect(calls).toEqual([["approve", { version_count: 4 }]]));
  });

  it("leaves a draft with four eyes to somebody who did not draw it", async () => {
    const draft = { is_approved: false, drawn_by: ["ada", "sue"] };
    const { unmount } = render(<Page zones={view(draft)} />);
    await screen.findByText("You drew it: in force once another supervisor approves it.");
    expect(screen.getByRole("button", { name: /Approve/ })).toHaveProperty("disabled", true);
    unmount();
    render(<Page zones={view({ ...draft, is_four_eyes: false })} />);
    await screen.findByText("You drew it yourself: look again before you approve it.");
    expect(screen.getByRole("button", { name: /Approve/ })).toHaveProperty("disabled", false);
  });

  it("tells others who approves", async () => {
    permissions = ["site.edit"];
    render(<Page zones={view({ is_approved: false })} />);
    expect(await screen.findByText("In force once a supervisor approves it.")).toBeTruthy();
    expect(screen.getByRole("button", { name: /Approve/ })).toHaveProperty("disabled", true);
  });
});
