import type { ReactNode } from "react";
import classes from "./Validation.module.css";

type Props = { label: string; children: ReactNode };

/** A table that is wider than its place: it scrolls, also by keys. */
export function ScrollTable({ label, children }: Props) {
  return (
    // biome-ignore lint/a11y/noNoninteractiveTabindex: without a place in the order keys cannot scroll it
    <section className={classes.scroll} aria-label={label} tabIndex={0}>
      <table className={classes.table}>{children}</table>
    </section>
  );
}
