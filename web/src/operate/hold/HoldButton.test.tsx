import { cleanup, fireEvent, render, screen } from "@testing-library/react";
import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import { HoldButton } from "./HoldButton";
import { type Hold, IDLE } from "./hold";

const press = vi.fn();
const release = vi.fn();

function show(isEnabled = true, hold: Hold = IDLE) {
  const view = render(<HoldButton control={{ hold, press, release }} isEnabled={isEnabled} />);
  return { ...view, button: screen.getByTestId("hold") };
}

const down = (button: HTMLElement, more = {}) =>
  fireEvent.pointerDown(button, { button: 0, isPrimary: true, pointerId: 1, ...more });

beforeEach(() => {
  press.mockReset();
  release.mockReset();
});
afterEach(cleanup);

describe("pointer and touch", () => {
  it("presses and lets go", () => {
    const { button } = show();
    down(button);
    fireEvent.pointerUp(button);
    expect(press).toHaveBeenCalledTimes(1);
    expect(release).toHaveBeenCalledExactlyOnceWith("released");
  });

  it("ignores the second finger and the right button", () => {
    const { button } = show();
    down(button, { isPrimary: false });
    down(button, { button: 2 });
    expect(press).not.toHaveBeenCalled();
  });

  it("lets go when the browser takes the pointer away", () => {
    const { button } = show();
    down(button);
    fireEvent.pointerCancel(button);
    expect(release).toHaveBeenCalledExactlyOnceWith("cancelled");
    down(button);
    fireEvent.lostPointerCapture(button);
    expect(release).toHaveBeenLastCalledWith("released");
  });

  it("does nothing while disabled", () => {
    const { button } = show(false);
    down(button);
    fireEvent.keyDown(button, { key: " " });
    expect(press).not.toHaveBeenCalled();
    expect(button.getAttribute("aria-disabled")).toBe("true");
  });
});

describe("key", () => {
  it("is held by space; repeats are not presses", () => {
    const { button } = show();
    fireEvent.keyDown(button, { key: " " });
    fireEvent.keyDown(button, { key: " ", repeat: true });
    fireEvent.keyDown(button, { key: " ", repeat: true });
    expect(press).toHaveBeenCalledTimes(1);
    expect(release).not.toHaveBeenCalled();
    fireEvent.keyUp(button, { key: " " });
    expect(release).toHaveBeenCalledExactlyOnceWith("released");
  });

  it("does not start on a repeat that began elsewhere", () => {
    const { button } = show();
    fireEvent.keyDown(button, { key: " ", repeat: true });
    fireEvent.keyDown(button, { key: "Enter" });
    expect(press).not.toHaveBeenCalled();
  });

  it("a pointer up elsewhere does not end a key hold", () => {
    const { button } = show();
    fireEvent.keyDown(button, { key: " " });
    fireEvent.pointerUp(button);
    expect(release).not.toHaveBeenCalled();
  });

  it("escape lets go", () => {
    const { button } = show();
    fireEvent.keyDown(button, { key: " " });
    fireEvent.keyDown(button, { key: "Escape" });
    expect(release).toHaveBeenCalledTimes(1);
  });
});

describe("whatever takes the attention away lets go", () => {
  it("blur of the button and of the window", () => {
    const { button } = show();
    down(button);
    fireEvent.blur(button);
    expect(release).toHaveBeenCalledExactlyOnceWith("blur");
    down(button);
    fireEvent.blur(window);
    expect(release).toHaveBeenCalledTimes(2);
  });

  it("a hidden page", () => {
    const { button } = show();
    down(button);
    vi.spyOn(document, "visibilityState", "get").mockReturnValue("hidden");
    fireEvent(document, new Event("visibilitychange"));
    expect(release).toHaveBeenCalledExactlyOnceWith("hidden");
    vi.restoreAllMocks();
  });

  it("leaving the page", () => {
    const { button, unmount } = show();
    down(button);
    unmount();
    expect(release).toHaveBeenCalled();
  });

  it("nothing, when nothing is held", () => {
    const { button, unmount } = show();
    fireEvent.blur(button);
    fireEvent.blur(window);
    fireEvent.pointerUp(button);
    unmount();
    expect(release).not.toHaveBeenCalled();
  });
});

it("says that letting go no longer stops after the commit point", () => {
  show(false, { phase: "committed", throwId: "t1", isPressed: true });
  expect(screen.getByText(/no longer stops it/)).toBeDefined();
  expect(screen.getByText(/STOP still works/)).toBeDefined();
});

describe("after the throw has ended under the finger", () => {
  const ended = (isEnabled: boolean) => (
    <HoldButton control={{ hold: IDLE, press, release }} isEnabled={isEnabled} onDown={onDown} />
  );
  const onDown = vi.fn();

  it.each([
    ["pointer", () => fireEvent.pointerUp(screen.getByTestId("hold"), { pointerId: 1 })],
    ["key", () => fireEvent.keyUp(screen.getByTestId("hold"), { key: " " })],
  ])("stays inert until it is lifted: %s", (by, lift) => {
    onDown.mockReset();
    const { rerender } = render(ended(true));
    const button = screen.getByTestId("hold");
    if (by === "pointer") down(button);
    else fireEvent.keyDown(button, { key: " " });
    rerender(ended(true));
    expect(onDown).toHaveBeenLastCalledWith(true);
    expect(button.getAttribute("aria-disabled")).toBe("true");
    expect(screen.getByText(/lift/)).toBeDefined();
    fireEvent.keyDown(button, { key: " ", repeat: true });
    fireEvent.keyDown(button, { key: " " });
    expect(press).toHaveBeenCalledTimes(1);
    lift();
    expect(onDown).toHaveBeenLastCalledWith(false);
    expect(button.getAttribute("aria-disabled")).toBe("false");
  });

  it("another finger lifted elsewhere changes nothing", () => {
    onDown.mockReset();
    render(ended(true));
    down(screen.getByTestId("hold"));
    fireEvent.pointerUp(document.body, { pointerId: 2 });
    expect(onDown).toHaveBeenLastCalledWith(true);
  });

  it("a new first finger stands for one that was lifted without a sign", () => {
    onDown.mockReset();
    render(ended(true));
    down(screen.getByTestId("hold"));
    fireEvent.pointerDown(document.body, { pointerId: 3, isPrimary: true });
    expect(onDown).toHaveBeenLastCalledWith(false);
  });
});
