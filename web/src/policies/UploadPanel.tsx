import { Button, TextInput } from "@mantine/core";
import { useMutation, useQueryClient } from "@tanstack/react-query";
import { useRef, useState } from "react";
import { useMay } from "../session/useSession";
import { errorWords } from "../words/errors";
import { percent } from "../words/format";
import classes from "./UploadPanel.module.css";
import { filesRefusal, uploadPolicy } from "./upload";

const MIN_REASON = 3;

/** Takes the three files of a version by drag and drop or from a chooser, and says what becomes of them. */
export function UploadPanel() {
  const mayUpload = useMay("policy.upload");
  return mayUpload ? <Panel /> : null;
}

function Panel() {
  const client = useQueryClient();
  const chooser = useRef<HTMLInputElement>(null);
  const running = useRef<AbortController | null>(null);
  const [files, setFiles] = useState<File[]>([]);
  const [reason, setReason] = useState("");
  const [isOver, setOver] = useState(false);
  const [sent, setSent] = useState(0);
  const upload = useMutation({
    mutationFn: () => {
      running.current = new AbortController();
      return uploadPolicy(files, reason.trim(), setSent, running.current.signal);
    },
    onSuccess: () => {
      setFiles([]);
      setReason("");
    },
    onSettled: () => void client.invalidateQueries({ queryKey: ["policies"] }),
  });
  const why = files.length > 0 ? filesRefusal(files) : null;
  const isReady = files.length > 0 && why === null && reason.trim().length >= MIN_REASON;
  const choose = (chosen: FileList | null) => {
    upload.reset();
    setSent(0);
    setFiles([...(chosen ?? [])]);
  };
  const submit = (event: React.FormEvent) => {
    event.preventDefault();
    if (isReady && !upload.isPending) upload.mutate();
  };
  return (
    <section className={classes.panel} aria-label="Upload a version">
      <h2>Upload a version</h2>
      <form onSubmit={submit} className={classes.form}>
        {/* biome-ignore lint/a11y/noStaticElementInteractions: the button inside does the same by keyboard */}
        <div
          className={classes.drop}
          data-over={isOver || undefined}
          data-testid="drop-policy"
          onDragOver={(event) => {
            event.preventDefault();
            setOver(true);
          }}
          onDragLeave={() => setOver(false)}
          onDrop={(event) => {
            event.preventDefault();
            setOver(false);
            choose(event.dataTransfer.files);
          }}
        >
          <p>
            {files.length > 0
              ? files.map((file) => file.name).join(", ")
              : "Drop policy.onnx, card.json and golden_vectors.json here"}
          </p>
          <Button variant="default" size="md" onClick={() => chooser.current?.click()}>
            Choose files
          </Button>
          <input
            ref={chooser}
            type="file"
            multiple
            hidden
            accept=".onnx,.json"
            aria-label="Files of the version"
            onChange={(event) => {
              choose(event.currentTarget.files);
              event.currentTarget.value = "";
            }}
          />
        </div>
        <TextInput
          label="Why"
          description="Kept in the history with your name"
          value={reason}
          minLength={MIN_REASON}
          maxLength={300}
          onChange={(event) => setReason(event.currentTarget.value)}
        />
        <Button type="submit" size="md" disabled={!isReady} loading={upload.isPending}>
          Upload
        </Button>
      </form>
      {upload.isPending && (
        <p role="status">
          <progress value={sent} max={1} aria-label="Sent" />{" "}
          {sent < 1 ? `${percent(sent)} sent` : "Sent. The server checks it."}
        </p>
      )}
      {upload.isPending && sent < 1 && (
        <Button variant="default" size="md" onClick={() => running.current?.abort()}>
          Cancel the upload
        </Button>
      )}
      {why && <p className={classes.refusal}>{why}</p>}
      {upload.isError && (
        <p className={classes.refusal} role="alert">
          {errorWords(upload.error)}
        </p>
      )}
      {upload.isSuccess && (
        <p role="status">
          {upload.data.policy_id} is uploaded. No machine loads it before it is approved.
        </p>
      )}
    </section>
  );
}
