import { cleanup, fireEvent, render, screen } from "@testing-library/react";
import { afterEach, expect, it } from "vitest";
import { Hash } from "./Hash";
import { Shortened } from "./Shortened";

afterEach(cleanup);

it("shows a text whole at a press and short at the next, with its name for a screen reader", () => {
  render(<Shortened short="Aborted" whole="Aborted: the hold was released." name="Outcome" />);
  const button = screen.getByRole("button", { name: "Outcome Aborted" });
  fireEvent.click(button);
  expect(button.textContent).toBe("Aborted: the hold was released.");
  expect(button.getAttribute("aria-expanded")).toBe("true");
  fireEvent.click(button);
  expect(button.textContent).toBe("Aborted");
});

it("shows a hash whole at a press, and nothing to press without one", () => {
  const value = "0123456789abcdef".repeat(4);
  const { rerender } = render(<Hash value={value} name="Version" />);
  const button = screen.getByRole("button", { name: "Version 01234567" });
  fireEvent.click(button);
  expect(button.textContent).toBe(value);
  rerender(<Hash value={null} name="Version" />);
  expect(screen.queryByRole("button")).toBeNull();
});
