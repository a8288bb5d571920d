import { useState } from "react";
import { GateSentence } from "../operate/GateSentence";
import { useMay } from "../session/useSession";
import { errorWords } from "../words/errors";
import { CourseChart } from "./CourseChart";
import { goalPlace } from "./goal";
import { JobHead } from "./JobHead";
import type { Job } from "./job";
import { LoadTable } from "./LoadTable";
import { NextLoads } from "./NextLoads";
import { SectionChart } from "./SectionChart";
import { SurfaceMap } from "./SurfaceMap";
import { useJob, useJobChange, useSurface } from "./useJobs";
import classes from "./Work.module.css";
import { figures } from "./words";

/** One job: how far it is, what comes next, the surface and what has been thrown. */
export function JobView({ jobId }: { jobId: string }) {
  const job = useJob(jobId);
  if (job.isError && !job.data) return <GateSentence sentence={errorWords(job.error)} />;
  // What was kept from an earlier visit may lack a load: its plan is not offered to aim at.
  return job.data ? <Loaded job={job.data} isFresh={job.isFetchedAfterMount} /> : null;
}

function Loaded({ job, isFresh }: { job: Job; isFresh: boolean }) {
  const change = useJobChange(job);
  const surface = useSurface(job);
  const mayEdit = useMay("throw");
  const [asked, setAsked] = useState<number | null>(null);
  const isOpen = job.status === "open";
  // A plan that was made anew may no longer have the proposal that was being moved.
  const moving = job.next.some((one) => one.proposal_count === asked) && isOpen ? asked : null;
  const place = goalPlace(job.file);
  return (
    <article className={classes.job} data-testid="job" data-version={job.version_count}>
      <JobHead job={job} mayEdit={mayEdit} change={change} />
      <dl className={classes.figures} data-testid="job-figures">
        {figures(job).map(({ name, value }) => (
          <div key={name}>
            <dt>{name}</dt>
            <dd>{value}</dd>
          </div>
        ))}
      </dl>
      <div className={classes.middle} data-ended={!isOpen || undefined}>
        {isOpen && isFresh && (
          <NextLoads
            job={job}
            mayEdit={mayEdit}
            change={change}
            moving={moving}
            onMoving={setAsked}
          />
        )}
        <div className={classes.map}>
          {surface.data && (
            <SurfaceMap
              job={job}
              surface={surface.data}
              moving={moving}
              onPoint={([x_m, y_m]) =>
                moving !== null &&
                change.mutate(
                  { kind: "move", body: { proposal_count: moving, x_m, y_m } },
                  { onSuccess: () => setAsked(null) },
                )
              }
            />
          )}
          {surface.isError && !surface.data && (
            <GateSentence sentence={errorWords(surface.error)} />
          )}
        </div>
      </div>
      <div className={classes.charts}>
        {surface.data && place && (
          <>
            <div className={classes.chart}>
              <SectionChart surface={surface.data} place={place} direction="along" />
            </div>
            <div className={classes.chart}>
              <SectionChart surface={surface.data} place={place} direction="across" />
            </div>
          </>
        )}
        <div className={classes.chart}>
          <CourseChart job={job} />
        </div>
      </div>
      <div className={classes.loads}>
        <h3>Loads</h3>
        <LoadTable job={job} />
      </div>
    </article>
  );
}
