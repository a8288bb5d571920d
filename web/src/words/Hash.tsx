import { useState } from "react";
import { shortHash } from "./format";
import classes from "./Hash.module.css";

/** A hash's first digits; a press shows it whole. */
export function Hash({ value, name }: { value: string | null | undefined; name: string }) {
  const [isWhole, setWhole] = useState(false);
  if (!value) return <>{shortHash(value)}</>;
  return (
    <button
      type="button"
      className={classes.hash}
      aria-expanded={isWhole}
      aria-label={`${name} ${isWhole ? value : shortHash(value)}`}
      onClick={() => setWhole(!isWhole)}
    >
      {isWhole ? value : shortHash(value)}
    </button>
  );
}
