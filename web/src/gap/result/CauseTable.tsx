import type { Schema } from "../../session/client";
import { type DiagnosisWords, SENTENCES } from "../words";
import classes from "./CauseTable.module.css";

type Props = {
  causes: readonly Schema["Cause"][];
  /** Texts of the causes, in the same order. */
  words: DiagnosisWords["causes"];
};

/** Which effect: hypotheses by probability, sizes with their 90 % intervals. */
export function CauseTable({ causes, words }: Props) {
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
        {words.map(({ title, probability, effects }, index) => (
          <tr key={`${title} ${causes[index]?.probability}`}>
            <td>
              <span className={classes.odds}>
                <span className={classes.share} aria-hidden>
                  <span style={{ width: `${100 * (causes[index]?.probability ?? 0)}%` }} />
                </span>
                {probability}
              </span>
            </td>
            <th scope="row">{title}</th>
            <td>
              <Sizes effects={effects} />
            </td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}

function Sizes({ effects }: { effects: Schema["EffectWords"][] }) {
  return effects.flatMap(({ title, sizes }) =>
    sizes.map((size) => (
      <div key={`${title} ${size.name}`}>
        {effects.length > 1 && `${title}: `}
        {size.name} <strong>{size.value}</strong>{" "}
        <span className={classes.dim}>({size.interval})</span>
      </div>
    )),
  );
}
