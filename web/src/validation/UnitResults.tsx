import type { EvaluationRow } from "../policies/evaluation";
import { RangePlot } from "../policies/RangePlot";
import type { Schema } from "../session/client";
import { count, fixed, metres } from "../words/format";
import { ScrollTable } from "./ScrollTable";
import { type Validation, validationLogHref } from "./useValidation";
import classes from "./Validation.module.css";
import { estimateWords } from "./words";

type Result = Schema["ValidationResult"];
type Version = Schema["VersionResult"];
type Unit = Schema["UnitLandings"];

/** Throws by machine, of the version and of the one that was active. */
export function UnitResults({ validation, result }: { validation: Validation; result: Result }) {
  const versions = [result.candidate, ...(result.active ? [result.active] : [])];
  return versions.map((version) => (
    <details key={version.policy_sha256}>
      <summary>
        Throws with {version.policy_id}: {count(version.units.length, "machine")}, seed{" "}
        {result.plan.seed}
      </summary>
      {version.latency && (
        <p>
          One run of the network takes {fixed(version.latency.p50_s * 1e3, 3)} ms, 1 of 100 takes
          longer than {fixed(version.latency.p99_s * 1e3, 3)} ms.
        </p>
      )}
      {version.units.map((unit) => (
        <UnitTable key={unit.unit_seed} unit={unit} version={version} />
      ))}
      <Failures validation={validation} version={version} result={result} />
    </details>
  ));
}

function UnitTable({ unit, version }: { unit: Unit; version: Version }) {
  const where = `virtual machine ${unit.unit_seed}${unit.is_registered ? "" : ", not registered"}`;
  return (
    <>
      <RangePlot rows={unit.targets.map(plainRow)} where={where} />
      <ScrollTable label={`${version.policy_id}, ${where}`}>
        <caption>
          With {where}: m, 95 % intervals. {unit.registration_note}
        </caption>
        <thead>
          <tr>
            <th scope="col">Range, m</th>
            <th scope="col">Landed</th>
            <th scope="col">Along: mean</th>
            <th scope="col">Along: sd</th>
            <th scope="col">Across: mean</th>
            <th scope="col">Across: sd</th>
          </tr>
        </thead>
        <tbody>
          {unit.targets.map((row) => (
            <tr key={row.range_m}>
              <th scope="row">{fixed(row.range_m)}</th>
              <td>
                {row.landed} of {row.throws}
              </td>
              <td>{estimateWords(row.mean_downrange_error_m, true)}</td>
              <td>{estimateWords(row.sd_downrange_m, false)}</td>
              <td>{estimateWords(row.mean_crossrange_error_m, true)}</td>
              <td>{estimateWords(row.sd_crossrange_m, false)}</td>
            </tr>
          ))}
        </tbody>
      </ScrollTable>
    </>
  );
}

function plainRow(row: Schema["TargetRow"]): EvaluationRow {
  return {
    range_m: row.range_m,
    height_m: 0,
    throw_count: row.throws,
    success_ratio: row.success_ratio.value,
    mean_downrange_error_m: row.mean_downrange_error_m.value,
    sd_downrange_m: row.sd_downrange_m.value,
    mean_crossrange_error_m: row.mean_crossrange_error_m.value,
    sd_crossrange_m: row.sd_crossrange_m.value,
  };
}

type FailuresProps = { validation: Validation; version: Version; result: Result };

/** Throws that did not land, with the log of some and the command that throws them again. */
function Failures({ validation, version, result }: FailuresProps) {
  const { plan } = result;
  const failed = version.units.flatMap((unit) => unit.failures.map((one) => ({ unit, one })));
  if (failed.length === 0) return <p>Every throw landed.</p>;
  const throws = (unit: Unit) =>
    unit.unit_seed === 0 ? plan.throws_per_target : plan.unseen_throws_per_target;
  const units = [...new Set(failed.map(({ unit }) => unit))];
  return (
    <>
      <ul className={classes.failures} aria-label={`Throws of ${version.policy_id} that failed`}>
        {failed.map(({ unit, one }) => (
          <li key={`${unit.unit_seed} ${one.number}`}>
            Machine {unit.unit_seed}, throw {one.number} at {metres(one.range_m)}:{" "}
            {one.outcome.replaceAll("_", " ")}
            {one.log && (
              <a href={validationLogHref(validation.validation_id, one.log)} download>
                Log
              </a>
            )}
          </li>
        ))}
      </ul>
      {units.map((unit) => (
        <p key={unit.unit_seed}>
          Machine {unit.unit_seed} again:{" "}
          <code>
            downrange evaluate --mode {plan.mode} --plant virtual --unit-seed {unit.unit_seed}{" "}
            --seed {plan.seed} --throws {throws(unit)} --targets {plan.ranges_m.join(",")} --policy
            FOLDER/
            {version.policy_id}
          </code>
        </p>
      ))}
    </>
  );
}
