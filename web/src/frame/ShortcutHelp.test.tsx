import { MantineProvider } from "@mantine/core";
import { cleanup, fireEvent, render, screen } from "@testing-library/react";
import { afterEach, beforeAll, expect, it } from "vitest";
import { stubResizeObserver } from "../testing";
import { ShortcutHelp } from "./ShortcutHelp";

beforeAll(stubResizeObserver);
afterEach(cleanup);

const show = () =>
  render(
    <MantineProvider env="test">
      <input aria-label="note" />
      <ShortcutHelp />
    </MantineProvider>,
  );

it("opens by a question mark", () => {
  show();
  expect(screen.queryByText("Shift+S")).toBeNull();
  fireEvent.keyDown(document.body, { key: "?" });
  expect(screen.getByText("Shift+S")).toBeDefined();
});

it("leaves a question mark that is typed", () => {
  show();
  fireEvent.keyDown(screen.getByLabelText("note"), { key: "?" });
  expect(screen.queryByText("Shift+S")).toBeNull();
});
