import { MantineProvider } from "@mantine/core";
import { cleanup, fireEvent, render, screen } from "@testing-library/react";
import { afterEach, beforeAll, describe, expect, it, vi } from "vitest";
import { stubResizeObserver } from "../../testing";
import { PaceSlider } from "./PaceSlider";

const onPace = vi.fn();

function show(isHeeded: boolean) {
  render(
    <MantineProvider>
      <PaceSlider pace_ratio={0.25} isHeeded={isHeeded} onPace={onPace} />
    </MantineProvider>,
  );
  return screen.getByRole("slider", { name: "Pace" });
}

beforeAll(stubResizeObserver);
afterEach(() => {
  cleanup();
  onPace.mockReset();
});

describe("the pace", () => {
  it("is set by keys, in words and numbers", () => {
    const slider = show(true);
    expect(screen.getByText("0.25, careful")).toBeTruthy();
    fireEvent.keyDown(slider, { key: "ArrowRight" });
    expect(onPace).toHaveBeenLastCalledWith(0.3);
    fireEvent.keyDown(slider, { key: "End" });
    expect(onPace).toHaveBeenLastCalledWith(1);
    expect(screen.getByText("1.00, fast")).toBeTruthy();
    fireEvent.keyDown(slider, { key: "Home" });
    expect(onPace).toHaveBeenLastCalledWith(0);
  });

  it("cannot be set for a policy that has one pace", () => {
    const slider = show(false);
    expect(screen.getByText("this policy has one pace")).toBeTruthy();
    fireEvent.keyDown(slider, { key: "ArrowRight" });
    expect(onPace).not.toHaveBeenCalled();
  });
});
