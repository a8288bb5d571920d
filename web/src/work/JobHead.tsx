import { Button, FileButton, Modal, TextInput } from "@mantine/core";
import { useState } from "react";
import { errorWords } from "../words/errors";
import { fixed } from "../words/format";
import { zonedStamp } from "../words/time";
import { goalWords } from "./goal";
import type { Job } from "./job";
import { RecordLoad } from "./RecordLoad";
import { SURVEY_TYPES, surveyOf } from "./survey";
import { reportHref, type useJobChange } from "./useJobs";
import classes from "./Work.module.css";
import { cubic } from "./words";

type Props = { job: Job; mayEdit: boolean; change: ReturnType<typeof useJobChange> };

/** What the job is, and what is done with it as a whole. */
export function JobHead({ job, mayEdit, change }: Props) {
  const [dialog, setDialog] = useState<"end" | "record" | null>(null);
  const [problem, setProblem] = useState<string | null>(null);
  const close = () => {
    change.reset();
    setDialog(null);
  };
  const upload = async (file: File | null) => {
    setProblem(null);
    try {
      const body = await surveyOf(file);
      if (body !== null) change.mutate({ kind: "survey", body });
    } catch (error) {
      setProblem(errorWords(error));
    }
  };
  const kind = change.variables?.kind;
  const isOurs = kind === "undo" || kind === "survey";
  const failed = change.isError && isOurs ? errorWords(change.error) : problem;
  const isOpen = job.status === "open";
  const hasLoad = job.loads.some((load) => !load.is_withdrawn);
  return (
    <header className={classes.head}>
      <div>
        <h2>{job.name}</h2>
        <p className={classes.goal}>{goalWords(job.file)}</p>
        <p className={classes.note}>
          {job.material.name}, grabs of {cubic(job.file.grab_m3)} ({fixed(job.grab_kg, 0)} kg),
          begun by {job.created_by} {zonedStamp(job.created_utc)}
          {!isOpen && `, ended by ${job.ended_by ?? "the server"} ${zonedStamp(job.ended_utc)}`}
        </p>
      </div>
      <div className={classes.actions}>
        <Button
          component="a"
          size="sm"
          variant="default"
          href={reportHref(job.job_id)}
          target="_blank"
          rel="noreferrer"
        >
          Report
        </Button>
        {isOpen && mayEdit && (
          <>
            <Button size="sm" variant="default" onClick={() => setDialog("record")}>
              Record a load
            </Button>
            <Button
              size="sm"
              variant="default"
              disabled={!hasLoad || change.isPending}
              loading={change.isPending && kind === "undo"}
              onClick={() => change.mutate({ kind: "undo", body: {} })}
            >
              Undo last load
            </Button>
            <FileButton accept={SURVEY_TYPES} onChange={(file) => void upload(file)}>
              {(props) => (
                <Button
                  {...props}
                  size="sm"
                  variant="default"
                  loading={change.isPending && kind === "survey"}
                >
                  Upload survey
                </Button>
              )}
            </FileButton>
            <Button size="sm" variant="default" onClick={() => setDialog("end")}>
              End job
            </Button>
          </>
        )}
      </div>
      {failed && (
        <p className={classes.refusal} role="alert">
          {failed}
        </p>
      )}
      {dialog === "end" && <EndDialog job={job} change={change} onClose={close} />}
      {dialog === "record" && <RecordLoad job={job} change={change} onClose={close} />}
    </header>
  );
}

type EndProps = Omit<Props, "mayEdit"> & { onClose: () => void };

function EndDialog({ job, change, onClose }: EndProps) {
  const [reason, setReason] = useState("");
  const submit = (event: React.FormEvent) => {
    event.preventDefault();
    change.mutate({ kind: "end", body: { reason: reason.trim() } }, { onSuccess: onClose });
  };
  return (
    <Modal opened onClose={onClose} title={`End ${job.name}`} centered>
      <form className={classes.dialog} onSubmit={submit}>
        <p className={classes.text}>
          It can be read afterwards, but no load is added to it any more. {job.machine_id} is then
          free for another job.
        </p>
        <TextInput
          size="md"
          label="Why, if it is not done"
          maxLength={300}
          value={reason}
          data-autofocus
          onChange={(event) => setReason(event.currentTarget.value)}
        />
        {change.isError && (
          <p className={classes.refusal} role="alert">
            {errorWords(change.error)}
          </p>
        )}
        <Button type="submit" size="md" loading={change.isPending}>
          End the job
        </Button>
      </form>
    </Modal>
  );
}
