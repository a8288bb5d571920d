import { Button } from "@mantine/core";
import { Link } from "@tanstack/react-router";
import { useState } from "react";
import { LandingPlot } from "../charts/LandingPlot";
import type { Plan, Throw } from "../session/live";
import { MarkImpact } from "../throws/MarkImpact";
import { MissTable } from "../throws/MissTable";
import { outcomeSentence } from "../throws/outcome";
import classes from "./Panel.module.css";
import { landingVerdict } from "./reason";

type Props = { thrown: Throw; plan: Plan | null; onAgain: () => void };

/** How it came out: predicted and measured, a likely reason, and what to do next. */
export function ResultStep({ thrown, plan, onAgain }: Props) {
  const [isMarking, setMarking] = useState(false);
  const verdict = landingVerdict(thrown, plan);
  const measured =
    thrown.measured_downrange_error_m !== null && thrown.measured_crossrange_error_m !== null
      ? {
          downrange_m: thrown.measured_downrange_error_m,
          crossrange_m: thrown.measured_crossrange_error_m,
        }
      : null;
  const prediction = plan?.prediction;
  return (
    <div data-testid="result">
      {thrown.outcome !== "landed" && (
        <p className={classes.refusal} role="status">
          {outcomeSentence(thrown)}
        </p>
      )}
      <div className={classes.landing}>
        {prediction && (
          <LandingPlot
            ellipse={prediction.ellipse}
            predicted={{
              downrange_m: prediction.downrange_error_m,
              crossrange_m: prediction.crossrange_error_m,
            }}
            measured={measured}
          />
        )}
        <MissTable thrown={thrown} />
      </div>
      {verdict && (
        <p className={verdict.isInside ? classes.note : classes.refusal}>{verdict.text}</p>
      )}
      {isMarking ? (
        <MarkImpact throwId={thrown.throw_id} onDone={() => setMarking(false)} />
      ) : (
        <div className={classes.actions}>
          <Button onClick={onAgain}>Throw again</Button>
          {thrown.outcome === "landed" && (
            <Button variant="default" onClick={() => setMarking(true)}>
              Mark impact
            </Button>
          )}
          <Button
            variant="default"
            renderRoot={(props) => (
              <Link to="/throws/$throwId" params={{ throwId: thrown.throw_id }} {...props} />
            )}
          >
            Open
          </Button>
        </div>
      )}
    </div>
  );
}
