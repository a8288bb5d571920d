import { Button } from "@mantine/core";
import { errorWords } from "../words/errors";
import { count, percent } from "../words/format";
import { shortStamp, zoneName } from "../words/time";
import type { useJobs } from "./useJobs";
import classes from "./Work.module.css";

type Props = {
  jobs: ReturnType<typeof useJobs>;
  selected: string | null;
  onSelect: (jobId: string) => void;
};

/** Jobs of the machine, newest first. */
export function JobList({ jobs, selected, onSelect }: Props) {
  return (
    <nav className={classes.list} aria-label="Jobs">
      <h2>
        Jobs <span className={classes.zone}>times in {zoneName(new Date())}</span>
      </h2>
      {jobs.isError && <p className={classes.refusal}>{errorWords(jobs.error)}</p>}
      {jobs.isSuccess && jobs.items.length === 0 && <p className={classes.note}>None yet.</p>}
      <ul>
        {jobs.items.map((job) => (
          <li key={job.job_id}>
            <button
              type="button"
              className={classes.entry}
              aria-current={job.job_id === selected}
              onClick={() => onSelect(job.job_id)}
            >
              <span className={classes.line}>
                <strong>{job.name}</strong>
                <span className={classes.dim}>{shortStamp(job.created_utc)}</span>
              </span>
              <span className={classes.dim}>
                {job.status === "open" ? "open" : "ended"}, {percent(job.filled_ratio)} filled,{" "}
                {count(job.load_count, "load")}, {job.created_by}
              </span>
            </button>
          </li>
        ))}
      </ul>
      {jobs.hasNextPage && (
        <Button size="sm" variant="default" m={12} onClick={() => void jobs.fetchNextPage()}>
          Older
        </Button>
      )}
    </nav>
  );
}
