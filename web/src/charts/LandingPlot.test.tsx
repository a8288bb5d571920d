import { cleanup, fireEvent, render, screen } from "@testing-library/react";
import { afterEach, expect, it, vi } from "vitest";
import { LandingPlot } from "./LandingPlot";

afterEach(cleanup);

const box = { left: 100, top: 50, width: 640, height: 300 } as DOMRect;

it("gives a click back in metres about the target, whatever the size of the picture", () => {
  const onPick = vi.fn();
  render(
    <LandingPlot ellipse={null} predicted={null} measured={null} least_m={0.6} onPick={onPick} />,
  );
  const plot = screen.getByRole("img");
  vi.spyOn(plot, "getBoundingClientRect").mockReturnValue(box);
  fireEvent.click(plot, { clientX: 420, clientY: 200 });
  expect(onPick.mock.lastCall?.[0].downrange_m).toBeCloseTo(0, 9);
  expect(onPick.mock.lastCall?.[0].crossrange_m).toBeCloseTo(0, 9);
  // Half the height, 150 pixels, is 0.6 m with a quarter of room: 0.75 m.
  fireEvent.click(plot, { clientX: 420 + 100, clientY: 200 - 50 });
  expect(onPick.mock.lastCall?.[0].downrange_m).toBeCloseTo(0.5, 9);
  expect(onPick.mock.lastCall?.[0].crossrange_m).toBeCloseTo(0.25, 9);
});

it("keeps its scale while the picked point moves", () => {
  const far = { downrange_m: 5, crossrange_m: 5 };
  const onPick = vi.fn();
  render(
    <LandingPlot ellipse={null} predicted={null} measured={far} least_m={0.6} onPick={onPick} />,
  );
  const plot = screen.getByRole("img");
  vi.spyOn(plot, "getBoundingClientRect").mockReturnValue(box);
  fireEvent.click(plot, { clientX: 420 + 100, clientY: 200 });
  expect(onPick.mock.lastCall?.[0].downrange_m).toBeCloseTo(0.5, 9);
});

it("names the ellipses on the side where the mark of the impact is not", () => {
  const ellipse = {
    mean_downrange_error_m: 0.1,
    mean_crossrange_error_m: 0,
    sd_downrange_m: 0.05,
    sd_crossrange_m: 0.02,
    correlation_ratio: 0,
    landed_count: 200,
    rollout_count: 200,
  };
  const at = (text: string) => Number(screen.getByText(text).getAttribute("x"));
  const { rerender } = render(
    <LandingPlot
      ellipse={ellipse}
      predicted={null}
      measured={{ downrange_m: 0.2, crossrange_m: 0 }}
    />,
  );
  expect(at("2σ")).toBeLessThan(at("1σ"));
  rerender(
    <LandingPlot
      ellipse={ellipse}
      predicted={null}
      measured={{ downrange_m: 0, crossrange_m: 0 }}
    />,
  );
  expect(at("2σ")).toBeGreaterThan(at("1σ"));
});
