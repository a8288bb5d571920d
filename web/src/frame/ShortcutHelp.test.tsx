import { MantineProvider } from "@mantine/core";
import { cleanup, fireEvent, render, screen } from "@testing-library/react";
import { afterEach, beforeAll, expect, it } from "vitest";
import { stubResizeObserver } from "../testing";
import { theme } from "../theme/theme";
import { ShortcutHelp } from "./ShortcutHelp";

beforeAll(stubResizeObserver);
afterEach(cleanup);

const show = () =>
  render(
    <MantineProvider env="test" theme={theme}>
      <input aria-label="note" />
      <ShortcutHelp />
    </MantineProvider>,
  );

it("opens by a question mark", () => {
  show();
  expect(screen.queryByText("Shift+S")).toBeNull();
  fireEvent.keyDown(document.body, { key: "?" });
  expect(screen.getByText("Shift+S")).toBeDefined();
  // Of the theme, so of every dialog: no second banner of the page, and a close button with a name.
  expect(screen.getByRole("button", { name: "Close" })).toBeDefined();
  expect(screen.getByRole("dialog").querySelector("header")?.getAttribute("role")).toBe(
    "presentation",
  );
});

it("leaves a question mark that is typed", () => {
  show();
  fireEvent.keyDown(screen.getByLabelText("note"), { key: "?" });
  expect(screen.queryByText("Shift+S")).toBeNull();
});
