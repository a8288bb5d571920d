import { cleanup, render, screen } from "@testing-library/react";
import { afterEach, describe, expect, it } from "vitest";
import { useFocusKept } from "./useFocusKept";

type Props = { label: string; isBusy?: boolean };

function Group({ label, isBusy = false }: Props) {
  const kept = useFocusKept<HTMLDivElement>();
  return (
    <>
      <input aria-label="elsewhere" />
      <div {...kept}>
        <button key={label} type="button" disabled={isBusy}>
          {label}
        </button>
      </div>
    </>
  );
}

afterEach(cleanup);

/** What a browser does with a focused button that is disabled or taken away. */
const loseFocus = () => (document.activeElement as HTMLElement).blur();

describe("the keyboard's place", () => {
  it("comes back to a button that was disabled, and to the one in its stead", () => {
    const { rerender } = render(<Group label="Apply" />);
    screen.getByRole("button").focus();
    rerender(<Group label="Apply" isBusy />);
    loseFocus();
    rerender(<Group label="Apply" />);
    expect(document.activeElement?.textContent).toBe("Apply");
    rerender(<Group label="Undo" />);
    expect(document.activeElement?.textContent).toBe("Undo");
  });

  it("is left alone where the person has gone elsewhere", () => {
    const { rerender } = render(<Group label="Apply" />);
    screen.getByRole("button").focus();
    screen.getByLabelText("elsewhere").focus();
    loseFocus();
    rerender(<Group label="Undo" />);
    expect(document.activeElement).toBe(document.body);
    screen.getByRole("button").focus();
    document.body.dispatchEvent(new Event("pointerdown", { bubbles: true }));
    loseFocus();
    rerender(<Group label="Apply" />);
    expect(document.activeElement).toBe(document.body);
  });
});
