import { errorWords } from "../words/errors";
import { percent } from "../words/format";
import { zonedStamp } from "../words/time";
import styles from "./CommissioningPanel.module.css";
import classes from "./Fleet.module.css";
import { type Commissioning, commissioningReportHref, useCommissioning } from "./useFleet";

/** The last commissioning of a machine, and the command that goes on with it. */
export function CommissioningPanel({ machineId }: { machineId: string }) {
  const found = useCommissioning(machineId);
  return (
    <section className={classes.panel} aria-label="Commissioning">
      <h2>Commissioning</h2>
      {found.isError && <p className={classes.dim}>{errorWords(found.error)}</p>}
      {found.data && <Measured machineId={machineId} found={found.data} />}
    </section>
  );
}

type Props = { machineId: string; found: Commissioning };

/** What was measured, what the twin does not explain, and what to do next. */
export function Measured({ machineId, found }: Props) {
  return (
    <div className={styles.body}>
      {found.problem ? (
        <p role="alert">{found.problem}</p>
      ) : (
        found.steps.length === 0 && (
          <p className={classes.dim}>
            Not commissioned yet: a diagnosis compares it with its type and sees large effects only.
          </p>
        )
      )}
      {found.flags.length > 0 && (
        <>
          <h3>To look at</h3>
          <ul className={classes.rows}>
            {found.flags.map((flag) => (
              <li key={flag}>{flag}</li>
            ))}
          </ul>
        </>
      )}
      {found.joints.length > 0 && <Joints joints={found.joints} />}
      {found.steps.length > 0 && (
        <dl className={classes.facts}>
          {found.steps.map((step) => (
            <Fact key={step.name} name={step.name}>
              {step.done_utc === null ? "not yet" : step.words}
              {step.done_utc !== null && (
                <span className={classes.sub}>{zonedStamp(step.done_utc)}</span>
              )}
            </Fact>
          ))}
          {found.quantities.map((one) => (
            <Fact key={one.name} name={one.name}>
              {one.value}
            </Fact>
          ))}
        </dl>
      )}
      <p>Kept: {found.reference}.</p>
      {found.has_report && (
        <a href={commissioningReportHref(machineId)} target="_blank" rel="noreferrer">
          Report of the commissioning
        </a>
      )}
      <p>
        It moves the machine, so it is started at the machine, with a person who holds the enabling
        switch:
      </p>
      <pre className={styles.command}>
        <code>{found.command}</code>
      </pre>
      <p className={classes.dim}>
        PLANT is the driver of what is measured. A stopped command goes on where it was; on another
        day it adds reference throws of that day.
      </p>
    </div>
  );
}

function Joints({ joints }: { joints: Commissioning["joints"] }) {
  return (
    <table className={styles.table}>
      <caption>Share of each joint's speed that the twin explains, on motions not fitted</caption>
      <thead>
        <tr>
          <th scope="col">Joint</th>
          <th scope="col">Model</th>
          <th scope="col">Explained</th>
          <th scope="col">Most of the rest</th>
          <th scope="col">At a bound</th>
        </tr>
      </thead>
      <tbody>
        {joints.map((one) => (
          <tr key={one.joint}>
            <th scope="row">{one.joint}</th>
            <td>{one.model}</td>
            <td>{percent(one.explained_ratio, 1)}</td>
            <td>{one.rest}</td>
            <td>{one.at_bound.join(", ") || "none"}</td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}

function Fact({ name, children }: { name: string; children: React.ReactNode }) {
  return (
    <>
      <dt>{name}</dt>
      <dd>{children}</dd>
    </>
  );
}
