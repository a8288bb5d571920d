import { fireEvent, render, screen } from "@testing-library/react";
import { expect, it } from "vitest";
import { Hash } from "./Hash";

it("shows a hash whole at a press, and nothing to press without one", () => {
  const value = "0123456789abcdef".repeat(4);
  const { rerender } = render(<Hash value={value} name="Version" />);
  const button = screen.getByRole("button", { name: "Version 01234567" });
  fireEvent.click(button);
  expect(button.textContent).toBe(value);
  fireEvent.click(button);
  expect(button.textContent).toBe("01234567");
  rerender(<Hash value={null} name="Version" />);
  expect(screen.queryByRole("button")).toBeNull();
});
