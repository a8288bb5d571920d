import { act, cleanup, fireEvent, render, screen } from "@testing-library/react";
import { afterEach, beforeEach, expect, it, vi } from "vitest";
import { StopAllButton } from "./StopAllButton";

const stop = vi.fn();
vi.mock("./useStop", () => ({ useStop: () => ({ stop, status: { kind: "idle", text: "" } }) }));

beforeEach(() => {
  stop.mockReset();
  vi.useFakeTimers();
});
afterEach(() => {
  cleanup();
  vi.useRealTimers();
});

const wait = (ms: number) => act(() => vi.advanceTimersByTime(ms));
const button = () => screen.getByTestId("stop-all");
const down = () => fireEvent.pointerDown(button(), { button: 0, isPrimary: true });

it("stops every machine after a hold of one second, once", () => {
  render(<StopAllButton />);
  down();
  wait(990);
  expect(stop).not.toHaveBeenCalled();
  wait(2000);
  expect(stop).toHaveBeenCalledTimes(1);
});

it.each([
  ["lifting", () => fireEvent.pointerUp(button())],
  ["sliding off", () => fireEvent.pointerOut(button(), { relatedTarget: document.body })],
  ["losing the focus", () => fireEvent.blur(button())],
])("does nothing after %s too early", (_, letGo) => {
  render(<StopAllButton />);
  down();
  wait(900);
  letGo();
  wait(2000);
  expect(stop).not.toHaveBeenCalled();
});

it("is held by key; a click alone does nothing", () => {
  render(<StopAllButton />);
  fireEvent.click(button());
  wait(2000);
  expect(stop).not.toHaveBeenCalled();
  fireEvent.keyDown(button(), { key: " " });
  fireEvent.keyDown(button(), { key: " ", repeat: true });
  wait(1000);
  expect(stop).toHaveBeenCalledTimes(1);
});
