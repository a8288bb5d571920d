import { Loader } from "@mantine/core";
import { LandingPlot } from "../charts/LandingPlot";
import type { Machine, Plan } from "../session/live";
import { CheckList } from "./CheckList";
import classes from "./Panel.module.css";
import { PreviewNumbers } from "./PreviewNumbers";

/** What the twin says: landing ellipse, numbers, and every check with its number and remedy. */
export function PreviewStep({ machine, plan }: { machine: Machine; plan: Plan | null }) {
  const prediction = plan?.prediction ?? null;
  return (
    <>
      {!plan && (
        <p className={classes.note}>
          <Loader size={12} mr={8} /> The twin throws it first.
        </p>
      )}
      {plan?.refusals.map((refusal) => (
        <p key={refusal.detail} className={classes.refusal} role="alert">
          {refusal.detail}
        </p>
      ))}
      {prediction && (
        <>
          <LandingPlot
            ellipse={prediction.ellipse}
            predicted={{
              downrange_m: prediction.downrange_error_m,
              crossrange_m: prediction.crossrange_error_m,
            }}
            measured={null}
          />
          <PreviewNumbers prediction={prediction} isComplete={plan?.is_complete ?? false} />
        </>
      )}
      <CheckList checks={machine.state?.checks ?? []} />
    </>
  );
}
