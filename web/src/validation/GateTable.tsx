import { unbroken } from "../words/format";
import { ScrollTable } from "./ScrollTable";
import type { GateCheck } from "./useValidation";
import classes from "./Validation.module.css";
import { gateNumber, limitWords } from "./words";

type Props = { checks: readonly GateCheck[]; policyId: string };

/** Every gate with the number that was measured. */
export function GateTable({ checks, policyId }: Props) {
  return (
    <ScrollTable label={`Gates of ${policyId}`}>
      <caption>Gates; the measured value counts, its 95 % interval is beside it</caption>
      <thead>
        <tr>
          <th scope="col">Gate</th>
          <th scope="col">Measured</th>
          <th scope="col">Limit</th>
          <th scope="col">Verdict</th>
          <th scope="col">Where</th>
        </tr>
      </thead>
      <tbody>
        {checks.map((check) => (
          <tr key={check.gate}>
            <th scope="row">{check.name}</th>
            <td>
              {gateNumber(check.value, check.unit)}
              {check.ci95 && (
                <span className={classes.note}>
                  {" "}
                  (
                  {unbroken(
                    `${gateNumber(check.ci95[0], check.unit)} to ${gateNumber(check.ci95[1], check.unit)}`,
                  )}
                  )
                </span>
              )}
            </td>
            <td>{unbroken(limitWords(check))}</td>
            <td data-look={!check.is_passed || undefined}>
              {check.is_passed ? "passed" : "not passed"}
            </td>
            <td>{check.where}</td>
          </tr>
        ))}
      </tbody>
    </ScrollTable>
  );
}
