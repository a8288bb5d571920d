import { useState } from "react";
import classes from "./Shortened.module.css";

type Props = { short: string; whole: string; name: string };

/** A text that is short where many stand together; a press, by finger or key, shows it whole. */
export function Shortened({ short, whole, name }: Props) {
  const [isWhole, setWhole] = useState(false);
  const text = isWhole ? whole : short;
  return (
    <button
      type="button"
      className={classes.shortened}
      aria-expanded={isWhole}
      aria-label={`${name} ${text}`}
      onClick={() => setWhole(!isWhole)}
    >
      {text}
    </button>
  );
}
