import classes from "./GateSentence.module.css";

/** A page that has nothing to show says why, and what to do. */
export function GateSentence({
  sentence,
  children,
}: {
  sentence: string;
  children?: React.ReactNode;
}) {
  return (
    <div className={classes.empty} role="status">
      <p>{sentence}</p>
      {children}
    </div>
  );
}
