import classes from "./ReasonList.module.css";
import type { Reason } from "./refused";

type Props = { title: string; reasons: readonly Reason[]; isOpen?: boolean };

/** Things and why, folded. */
export function ReasonList({ title, reasons, isOpen = false }: Props) {
  if (reasons.length === 0) return null;
  return (
    <details className={classes.list} open={isOpen}>
      <summary>
        {title} ({reasons.length})
      </summary>
      <dl>
        {reasons.map((reason) => (
          <div key={`${reason.name} ${reason.why}`}>
            <dt>{reason.name}</dt>
            <dd>{reason.why}</dd>
          </div>
        ))}
      </dl>
    </details>
  );
}
