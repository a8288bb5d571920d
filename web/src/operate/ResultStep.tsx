import { Button } from "@mantine/core";
import { Link } from "@tanstack/react-router";
import { LandingPlot } from "../charts/LandingPlot";
import type { Plan, Throw } from "../session/live";
import { useMay } from "../session/useSession";
import { MarkImpact } from "../throws/MarkImpact";
import { MissTable } from "../throws/MissTable";
import { measuredOf, predictedOf } from "../throws/marking";
import { hasLanded, outcomeSentence } from "../throws/outcome";
import { useOpenJob } from "../work/useJobs";
import classes from "./Panel.module.css";
import { landingVerdict } from "./reason";

type Props = {
  thrown: Throw;
  plan: Plan | null;
  onAgain: () => void;
  isMarking: boolean;
  onMarking: (isMarking: boolean) => void;
};

/** How it came out: predicted and measured, a likely reason, and what to do next. */
export function ResultStep({ thrown, plan, onAgain, isMarking, onMarking }: Props) {
  const verdict = landingVerdict(thrown, plan);
  const job = useOpenJob(thrown.machine_id);
  const mayMark = useMay("impact.mark") && hasLanded(thrown);
  if (isMarking) return <MarkImpact thrown={thrown} plan={plan} onDone={() => onMarking(false)} />;
  return (
    <div data-testid="result">
      {thrown.outcome !== "landed" && (
        <p className={classes.refusal} role="status">
          {outcomeSentence(thrown)}
        </p>
      )}
      <div className={classes.landing}>
        {plan?.prediction && (
          <LandingPlot
            ellipse={plan.prediction.ellipse}
            predicted={predictedOf(plan)}
            measured={measuredOf(thrown)}
          />
        )}
        <MissTable thrown={thrown} />
      </div>
      {verdict && (
        <p className={verdict.isInside ? classes.note : classes.refusal}>{verdict.text}</p>
      )}
      <div className={classes.actions}>
        <Button onClick={onAgain}>Throw again</Button>
        {mayMark && (
          <Button variant="default" onClick={() => onMarking(true)}>
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
        {job.data && (
          <Button
            variant="default"
            renderRoot={(props) => (
              <Link to="/work" search={{ job: job.data?.job_id }} {...props} />
            )}
          >
            Next load
          </Button>
        )}
      </div>
    </div>
  );
}
