import { Button } from "@mantine/core";
import { useNavigate, useSearch } from "@tanstack/react-router";
import { useState } from "react";
import { useMachine } from "../machine/useMachine";
import { GateSentence } from "../operate/GateSentence";
import type { Machine } from "../session/live";
import { useMay } from "../session/useSession";
import { useSite } from "../site/useSite";
import { errorWords } from "../words/errors";
import { JobList } from "../work/JobList";
import { JobView } from "../work/JobView";
import { NewJobDialog } from "../work/NewJobDialog";
import { useJobs } from "../work/useJobs";
import classes from "../work/Work.module.css";

/** Work: fill, build and clear with bulk material; jobs at the left, the chosen one at the right. */
export function WorkPage() {
  const machine = useMachine();
  if (!machine) {
    return <GateSentence sentence="No machine is known yet. Fleet shows how one is added." />;
  }
  return <WorkOf key={machine.machine_id} machine={machine} />;
}

function WorkOf({ machine }: { machine: Machine }) {
  const { machine_id } = machine;
  const wanted = useSearch({ from: "/frame/work" }).job;
  const navigate = useNavigate({ from: "/work" });
  const jobs = useJobs(machine_id);
  const site = useSite(machine_id);
  const mayEdit = useMay("throw");
  const [isAsking, setAsking] = useState(false);
  const open = jobs.items.find((job) => job.status === "open");
  const known = jobs.items.find((job) => job.job_id === wanted);
  const shown = (known ?? open ?? jobs.items[0])?.job_id ?? null;
  const select = (job: string) => void navigate({ search: { job } });
  const newJob = (
    <Button
      size="md"
      disabled={!mayEdit || open !== undefined || !site.data}
      onClick={() => setAsking(true)}
    >
      New job
    </Button>
  );
  return (
    <div className={classes.page}>
      <h1 className="visually-hidden">Work of {machine_id}</h1>
      {shown ? (
        <>
          <div className={classes.side}>
            <div className={classes.start}>
              {newJob}
              <p className={classes.note}>{newJobWords(mayEdit, open?.name)}</p>
            </div>
            <JobList jobs={jobs} selected={shown} onSelect={select} />
          </div>
          <div className={classes.main}>
            <JobView key={shown} jobId={shown} />
          </div>
        </>
      ) : (
        <div className={classes.main}>
          {jobs.isError && <GateSentence sentence={errorWords(jobs.error)} />}
          {jobs.isSuccess && (
            <GateSentence
              sentence={`${machine_id} has no job yet: a job says where the next loads go to fill a truck bed or a pit, or to build a pile.`}
            >
              {newJob}
              {!mayEdit && <p>Your role may look. Operators start jobs.</p>}
            </GateSentence>
          )}
        </div>
      )}
      {isAsking && site.data && (
        <NewJobDialog
          machine={machine}
          objects={site.data.objects}
          onStarted={(job) => {
            setAsking(false);
            select(job);
          }}
          onClose={() => setAsking(false)}
        />
      )}
    </div>
  );
}

function newJobWords(mayEdit: boolean, open: string | undefined): string {
  if (!mayEdit) return "Your role may look. Operators start jobs.";
  return open ? `End ${open} first: a machine has one open job.` : "";
}
