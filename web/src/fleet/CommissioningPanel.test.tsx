import { cleanup, render, screen, within } from "@testing-library/react";
import { afterEach, describe, expect, it } from "vitest";
import { Measured } from "./CommissioningPanel";
import type { Commissioning } from "./useFleet";

afterEach(cleanup);

const nothing: Commissioning = {
  command: "downrange commission --plant PLANT --machine-id m001 --out /data/machines",
  steps: [],
  joints: [],
  quantities: [],
  flags: [],
  reference: "no reference throws. At least 12 are needed: run `downrange commission`",
  has_report: false,
  problem: "",
};

describe("the commissioning of a machine", () => {
  it("says what a machine without one lacks, and the command", () => {
    render(<Measured machineId="m001" found={nothing} />);
    expect(screen.getByText(/Not commissioned yet/)).toBeTruthy();
    expect(screen.getByText(nothing.command)).toBeTruthy();
    expect(screen.queryByRole("link")).toBeNull();
    expect(screen.queryByRole("button")).toBeNull();
  });

  it("says what the twin does not explain, what sits at a bound, and links the report", () => {
    const flag = "slew: gain_ratio is at a bound of the search.";
    render(
      <Measured
        machineId="m 1"
        found={{
          ...nothing,
          steps: [{ name: "drives", done_utc: "2026-05-01T10:00:00Z", words: "4 joints" }],
          joints: [
            {
              joint: "slew",
              model: "oil spring",
              explained_ratio: 0.951,
              linear_explained_ratio: 0.9,
              rest: "70 % in what follows, such as ringing",
              at_bound: ["gain_ratio"],
            },
          ],
          quantities: [{ name: "release delay", value: "0.257 s, n 39" }],
          flags: [flag],
          has_report: true,
        }}
      />,
    );
    const row = screen.getByRole("row", { name: /slew/ });
    expect(within(row).getByText("95.1 %")).toBeTruthy();
    expect(within(row).getByText("gain_ratio")).toBeTruthy();
    expect(screen.getByText(flag)).toBeTruthy();
    expect(screen.getByText("0.257 s, n 39")).toBeTruthy();
    expect(screen.getByRole("link").getAttribute("href")).toBe(
      "/api/v1/machines/m%201/commissioning/report.html",
    );
  });

  it("says why a damaged record is not shown", () => {
    render(<Measured machineId="m001" found={{ ...nothing, problem: "it is no record" }} />);
    expect(screen.getByRole("alert").textContent).toBe("it is no record");
    expect(screen.queryByText(/Not commissioned yet/)).toBeNull();
  });
});
