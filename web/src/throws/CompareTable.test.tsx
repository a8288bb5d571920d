import { MantineProvider } from "@mantine/core";
import { render, screen } from "@testing-library/react";
import { expect, test, vi } from "vitest";
import type { Throw } from "../session/live";
import { CompareTable } from "./CompareTable";

vi.mock("@tanstack/react-router", () => ({
  Link: ({ children }: { children: React.ReactNode }) => <a href="#throw">{children}</a>,
}));

const row = (throw_id: string, range_m: number, along_m: number) =>
  ({
    throw_id,
    machine_id: "m001",
    mode: "2d",
    phase: "ended",
    outcome: "landed",
    policy_id: "m545-2d-v7",
    pace_ratio: 0.5,
    created_utc: "2026-11-21T04:03:09Z",
    target: { range_m, azimuth_rad: 0, x_m: range_m, y_m: 0, z_m: 0 },
    predicted_downrange_error_m: 0.02,
    measured_downrange_error_m: along_m,
    predicted_crossrange_error_m: 0,
    measured_crossrange_error_m: 0,
  }) as unknown as Throw;

test("throws stand side by side, and lines in which they differ are marked", () => {
  render(
    <MantineProvider>
      <CompareTable throws={[row("a", 9, 0.1), row("b", 8.5, -0.2)]} onClear={() => undefined} />
    </MantineProvider>,
  );
  const line = (name: string) => screen.getByRole("row", { name: new RegExp(`^${name}`) });
  expect(line("Target").textContent).toBe("Target9.00 m8.50 m");
  expect(line("Measured along").textContent).toContain("−0.20 m short");
  expect(line("Target").hasAttribute("data-differs")).toBe(true);
  expect(line("Machine").hasAttribute("data-differs")).toBe(false);
});
