import { Loader } from "@mantine/core";
import { LandingPlot } from "../../charts/LandingPlot";
import type { Schema } from "../../session/client";
import type { Machine, Plan } from "../../session/live";
import type { Gate } from "../gate";
import classes from "../Panel.module.css";
import { CheckList } from "./CheckList";
import { PreviewNumbers } from "./PreviewNumbers";
import { isRepeatedCheck, refusalsWithoutRepeats } from "./repeatedMessages";

type Props = {
  machine: Machine;
  plan: Plan | null;
  /** The ellipse of the last preview, until this one has its own. */
  estimate: Schema["LandingEllipse"] | null;
  /** What the foot of the panel says; it is not said twice. */
  gate: Gate | null;
};

/** What the twin says: landing ellipse, numbers, and every check with its number and remedy. */
export function PreviewStep({ machine, plan, estimate, gate }: Props) {
  const prediction = plan?.prediction ?? null;
  const checks = machine.state?.checks ?? [];
  return (
    <>
      {!plan && (
        <p className={classes.note}>
          <Loader size={12} mr={8} /> The twin throws it first.
        </p>
      )}
      {!prediction && plan?.state !== "refused" && estimate && (
        <div className={classes.estimate} data-testid="estimate">
          <LandingPlot ellipse={estimate} predicted={null} measured={null} />
          <p className={classes.note}>Estimated from the last preview.</p>
        </div>
      )}
      {refusalsWithoutRepeats(plan?.refusals ?? [], gate).map((refusal) => (
        <p key={refusal.detail} className={classes.refusal} role="alert">
          {refusal.detail}
        </p>
      ))}
      {prediction && (
        <div className={classes.landing}>
          <LandingPlot
            ellipse={prediction.ellipse}
            predicted={{
              downrange_m: prediction.downrange_error_m,
              crossrange_m: prediction.crossrange_error_m,
            }}
            measured={null}
          />
          <PreviewNumbers
            prediction={prediction}
            isComplete={plan?.is_complete ?? false}
            aim={plan?.aim ?? null}
            material={plan?.material ?? null}
          />
        </div>
      )}
      <CheckList checks={checks} isTold={(check) => isRepeatedCheck(check, gate)} />
    </>
  );
}
