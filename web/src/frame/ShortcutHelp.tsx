import { Modal } from "@mantine/core";
import { useEffect, useState } from "react";
import classes from "./ShortcutHelp.module.css";

const KEYS: readonly [string, string][] = [
  ["Shift+S", "STOP the machine shown, on every page"],
  ["Space", "Hold to throw, while its button has the focus; Escape lets go"],
  ["Arrows", "Move the target by 5 cm: up is longer, left is left"],
  ["Up, Down, Enter", "Throws: choose a row, open it"],
  ["?", "This list"],
];

/** Elements that take a question mark as text. */
const TEXT = "input, textarea, select, [contenteditable]";

/** The keys of the console, shown by `?`. */
export function ShortcutHelp() {
  const [isOpen, setOpen] = useState(false);
  useEffect(() => {
    const onKey = (event: KeyboardEvent) => {
      if (event.key !== "?" || event.ctrlKey || event.metaKey || event.altKey) return;
      if (event.target instanceof Element && event.target.closest(TEXT)) return;
      setOpen(true);
    };
    document.addEventListener("keydown", onKey);
    return () => document.removeEventListener("keydown", onKey);
  }, []);
  return (
    <Modal opened={isOpen} onClose={() => setOpen(false)} title="Keys" size="md">
      <dl className={classes.keys}>
        {KEYS.map(([key, meaning]) => (
          <div key={key}>
            <dt>
              <kbd>{key}</kbd>
            </dt>
            <dd>{meaning}</dd>
          </div>
        ))}
      </dl>
    </Modal>
  );
}
