import { Button } from "@mantine/core";
import { count, percent } from "../words/format";
import { shortStamp, zoneName } from "../words/time";
import classes from "./RunList.module.css";
import type { useGapRuns } from "./useGap";
import { isLook, isOpen, type Run, runWord } from "./words";

type Props = {
  runs: ReturnType<typeof useGapRuns>;
  selected: string | null;
  onSelect: (runId: string) => void;
};

/** History of diagnoses, newest first. */
export function RunList({ runs, selected, onSelect }: Props) {
  return (
    <section className={classes.list} aria-label="Diagnoses">
      <h2>
        Diagnoses <span className={classes.zone}>times in {zoneName(new Date())}</span>
      </h2>
      {runs.isSuccess && runs.rows.length === 0 && <p className={classes.none}>None yet.</p>}
      <ul>
        {runs.rows.map((run) => (
          <li key={run.gap_run_id}>
            <button
              type="button"
              className={classes.run}
              aria-current={run.gap_run_id === selected}
              onClick={() => onSelect(run.gap_run_id)}
            >
              <span className={classes.top}>
                <strong data-look={isLook(run.verdict) || undefined}>{runWord(run)}</strong>
                <span className={classes.dim}>{shortStamp(run.created_utc)}</span>
              </span>
              <span className={classes.dim}>{lineOf(run)}</span>
              {run.sentence && <span className={classes.sentence}>{run.sentence}</span>}
            </button>
          </li>
        ))}
      </ul>
      {runs.hasNextPage && (
        <Button size="xs" variant="default" m={12} onClick={() => void runs.fetchNextPage()}>
          Older
        </Button>
      )}
    </section>
  );
}

function lineOf(run: Run): string {
  const parts = [count(run.throw_count, "throw")];
  if (run.reference_throw_count > 0) parts.push(`${run.reference_throw_count} healthy`);
  parts.push(`twin version ${run.profile_version_count}`);
  if (isOpen(run)) parts.push(percent(run.progress_ratio));
  if (run.applied_version_count !== null) parts.push(`applied as ${run.applied_version_count}`);
  return `${parts.join(", ")}, ${run.created_by}`;
}
