import { Button, Progress } from "@mantine/core";
import type { Schema } from "../../session/client";
import { useMay } from "../../session/useSession";
import { errorWords } from "../../words/errors";
import { count, percent, unbroken } from "../../words/format";
import { zonedStamp } from "../../words/time";
import { reportHref, useGapActions } from "../useGap";
import {
  type DiagnosisWords,
  isLook,
  isOpen,
  type Run,
  runTitle,
  SENTENCES,
  usualWords,
} from "../words";
import classes from "./RunHead.module.css";

type Props = {
  run: Run;
  words: DiagnosisWords | null;
  /** The same throws once more. */
  again: Schema["GapRunRequest"];
  onStarted: (runId: string) => void;
};

/** What a run says: its verdict as a sentence, or how far it is and a way to stop it. */
export function RunHead({ run, words, again, onStarted }: Props) {
  const { cancel, start } = useGapActions(run.machine_id);
  const mayRun = useMay("gap.run");
  return (
    <header className={classes.head}>
      <div className={classes.line}>
        <span className={classes.kind} data-look={isLook(run.verdict) || undefined}>
          {runTitle(run)}
        </span>
        <div className={classes.actions}>
          {!isOpen(run) && mayRun && (
            <Button
              size="xs"
              variant="default"
              loading={start.isPending}
              onClick={() =>
                start.mutate(again, { onSuccess: (next) => onStarted(next.gap_run_id) })
              }
            >
              Diagnose again
            </Button>
          )}
          {run.state === "done" && (
            <Button
              component="a"
              size="xs"
              variant="default"
              href={reportHref(run.machine_id, run.gap_run_id)}
              target="_blank"
              rel="noreferrer"
            >
              Report
            </Button>
          )}
        </div>
        <span className={`${classes.dim} ${classes.about}`}>
          {count(run.throw_count, "throw")} of {run.machine_id} against twin version{" "}
          {run.profile_version_count}, compared with {run.compared_with},{" "}
          {zonedStamp(run.created_utc)}, {run.created_by}
        </span>
      </div>
      {start.isError && (
        <p className={classes.detail} role="alert">
          {errorWords(start.error)}
        </p>
      )}
      {run.sentence && <p className={classes.sentence}>{unbroken(run.sentence)}</p>}
      {run.detail && (
        <p className={classes.detail} role="alert">
          {run.detail}
        </p>
      )}
      {isOpen(run) && (
        <div className={classes.progress}>
          <Progress
            value={100 * run.progress_ratio}
            size="lg"
            aria-label="Progress of the diagnosis"
          />
          <span aria-live="polite">
            {run.state === "queued" ? "Waiting for its turn" : run.step},{" "}
            {percent(run.progress_ratio)}
          </span>
          <span className={classes.dim}>{usualWords(run)}</span>
          <Button
            variant="default"
            disabled={!mayRun}
            loading={cancel.isPending}
            onClick={() => cancel.mutate(run.gap_run_id)}
          >
            Cancel
          </Button>
          {cancel.isError && (
            <p className={classes.detail} role="alert">
              {errorWords(cancel.error)}
            </p>
          )}
        </div>
      )}
      {words && <Outcome words={words} />}
    </header>
  );
}

/** What to do next, and the numbers under the verdict: the same as in the report. */
function Outcome({ words }: { words: DiagnosisWords }) {
  return (
    <>
      {words.action && (
        <p className={classes.action}>
          <strong>{SENTENCES.section_action}:</strong> {unbroken(words.action)}
        </p>
      )}
      {words.facts.length > 0 && (
        <dl className={classes.facts}>
          {words.facts.map(({ name, value }) => (
            <div key={name}>
              <dt>{name}</dt>
              <dd>{value}</dd>
            </div>
          ))}
        </dl>
      )}
    </>
  );
}
