import type { Schema } from "../../session/client";
import { causeWords, fittedWords, probabilityWords, SENTENCES, sizesOf } from "../words";
import classes from "./CauseTable.module.css";

/** Which effect: hypotheses by probability, sizes with their 90 % intervals. */
export function CauseTable({ causes }: { causes: readonly Schema["Cause"][] }) {
  return (
    <table className={classes.causes}>
      <thead>
        <tr>
          <th scope="col">{SENTENCES.column_probability}</th>
          <th scope="col">{SENTENCES.column_cause}</th>
          <th scope="col">{SENTENCES.column_size}</th>
        </tr>
      </thead>
      <tbody>
        {causes.map((cause) => (
          <tr key={`${causeWords(cause)} ${cause.probability}`}>
            <td>
              <span className={classes.odds}>
                <span className={classes.share} aria-hidden>
                  <span style={{ width: `${100 * cause.probability}%` }} />
                </span>
                {probabilityWords(cause.probability)}
              </span>
            </td>
            <th scope="row">{causeWords(cause)}</th>
            <td>
              <Sizes cause={cause} />
            </td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}

function Sizes({ cause }: { cause: Schema["Cause"] }) {
  const isSeveral = cause.effects.length > 1;
  return cause.effects.flatMap((effect) =>
    sizesOf(effect).map((size) => (
      <div key={`${effect.effect} ${effect.joint} ${size.name}`}>
        {isSeveral && `${fittedWords(effect)}: `}
        {size.name} <strong>{size.value}</strong>{" "}
        <span className={classes.dim}>({size.interval})</span>
      </div>
    )),
  );
}
