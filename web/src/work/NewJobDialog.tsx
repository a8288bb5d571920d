import {
  Button,
  FileInput,
  Modal,
  NativeSelect,
  NumberInput,
  SegmentedControl,
  TextInput,
} from "@mantine/core";
import { useEffect, useRef, useState } from "react";
import { MATERIALS } from "../api/vocabulary";
import { reachWords } from "../operate/target/TargetStep";
import type { Machine } from "../session/live";
import type { SiteObject } from "../site/objects";
import { errorWords } from "../words/errors";
import { fixed } from "../words/format";
import { fieldOf } from "./fieldErrors";
import { fillsBed, firstForm, goalChoices, type JobForm, jobFile, loadReachWords } from "./goal";
import { SURVEY_TYPES, surveyOf } from "./survey";
import { useStartJob } from "./useJobs";
import classes from "./Work.module.css";

type Props = {
  machine: Machine;
  objects: readonly SiteObject[];
  onStarted: (jobId: string) => void;
  onClose: () => void;
};

/** What shall be built, from what, and how much a grab holds. */
export function NewJobDialog({ machine, objects, onStarted, onClose }: Props) {
  const { modes } = machine.reach;
  const [survey, setSurvey] = useState<File | null>(null);
  const choices = goalChoices(objects, survey !== null);
  const first = (goal?: string) => {
    const found = choices.find(({ value }) => value === goal) ?? choices[0];
    return found ? firstForm(found, machine.target ?? null) : null;
  };
  const [form, setForm] = useState(first);
  const start = useStartJob();
  const fields = useRef<HTMLFormElement>(null);
  useEffect(() => {
    // The refused field may be scrolled out of sight.
    if (start.isError) fields.current?.querySelector<HTMLElement>("[aria-invalid=true]")?.focus();
  }, [start.isError]);
  const choice = choices.find(({ value }) => value === form?.goal) ?? choices[0];
  if (!form || !choice) return null;
  const set = (change: Partial<JobForm>) => setForm({ ...form, ...change });
  const chooseGoal = (goal: string) => {
    const next = first(goal);
    // What says nothing of the place stays as it was typed.
    if (next) setForm({ ...next, material: form.material, grab_m3: form.grab_m3 });
  };
  const submit = (event: React.FormEvent) => {
    event.preventDefault();
    if (start.isPending) return;
    const file = jobFile(form, choice, survey?.name ?? null);
    start.mutate(
      { machine_id: machine.machine_id, file, survey: () => surveyOf(survey) },
      { onSuccess: (job) => onStarted(job.job_id) },
    );
  };
  const field = start.error ? fieldOf(start.error) : null;
  const errorAt = (name: string) =>
    field === name && start.error ? errorWords(start.error) : undefined;
  const reached = modes.filter((one) => form.mode === null || one.mode === form.mode);
  const number = (label: string, name: keyof JobForm, suffix: string, limits: object) => (
    <NumberInput
      size="md"
      label={label}
      suffix={suffix}
      decimalScale={2}
      allowedDecimalSeparators={[".", ","]}
      value={form[name] as number}
      error={errorAt(name)}
      onChange={(value) => typeof value === "number" && set({ [name]: value })}
      {...limits}
    />
  );
  const isTyped = choice.item === null || choice.kind === "clear";
  return (
    <Modal opened onClose={onClose} title={`New job for ${machine.machine_id}`} size="lg" centered>
      <form ref={fields} onSubmit={submit} className={classes.dialog}>
        <NativeSelect
          size="md"
          label="Goal"
          data={choices.map(({ value, label }) => ({ value, label }))}
          value={choice.value}
          error={errorAt("goal")}
          data-autofocus
          onChange={(event) => chooseGoal(event.currentTarget.value)}
        />
        <div className={classes.fields}>
          {fillsBed(choice.kind) && (
            <>
              {number("Height of its walls", "wall_m", " m", { min: 0.1, max: 4, step: 0.1 })}
              {number("Fill the walls to", "fill_percent", " %", { min: 10, max: 100, step: 5 })}
            </>
          )}
          {(choice.kind === "pit" || choice.kind === "trench") &&
            number("Level to", "top_m", " m", { min: -1, max: 1, step: 0.1 })}
          {isTyped && (
            <>
              {number(choice.kind === "clear" ? "Heap's range" : "Range", "range_m", " m", {
                min: 0.5,
                max: 55,
                step: 0.5,
              })}
              {number("Azimuth, left +", "azimuth_deg", "°", { min: -180, max: 180, step: 5 })}
              {number("Length, outward", "length_m", " m", { min: 0.3, max: 30, step: 0.5 })}
              {number("Width, across", "width_m", " m", { min: 0.3, max: 30, step: 0.5 })}
            </>
          )}
          {choice.kind === "pile" &&
            number("Height", "height_m", " m", { min: 0.1, max: 5, step: 0.1 })}
        </div>
        <div className={classes.fields}>
          <NativeSelect
            size="md"
            label="Material"
            data={Object.keys(MATERIALS)}
            value={form.material}
            error={errorAt("material")}
            onChange={(event) => set({ material: event.currentTarget.value })}
          />
          {number("Volume of a grab", "grab_m3", " m³", { min: 0.01, max: 3, step: 0.05 })}
        </div>
        <p className={classes.note}>{materialWords(form.material, form.grab_m3)}</p>
        <SegmentedControl
          aria-label="How to throw"
          data={[
            { value: "best", label: "Best for each load" },
            { value: "2d", label: "2D arm plane" },
            { value: "3d", label: "3D with cabin" },
          ]}
          value={form.mode ?? "best"}
          onChange={(mode) => set({ mode: mode === "2d" || mode === "3d" ? mode : null })}
        />
        {reached.map((reach) => (
          <p key={reach.mode} className={classes.note}>
            {reachWords(reach)} {loadReachWords(reach, grabKg(form))}
          </p>
        ))}
        <FileInput
          size="md"
          label="Survey of the ground"
          description="CSV x_m,y_m,z_m, GeoTIFF, LAS or LAZ, in metres from the slew axis. Without it the ground is level; a trench or a heap needs one."
          classNames={{ placeholder: classes.placeholder }}
          placeholder="None"
          accept={SURVEY_TYPES}
          clearable
          clearButtonProps={{ "aria-label": "Without a survey" }}
          value={survey}
          error={errorAt("survey")}
          onChange={setSurvey}
        />
        <TextInput
          size="md"
          label="Name"
          required
          maxLength={80}
          value={form.name}
          error={errorAt("name")}
          onChange={(event) => set({ name: event.currentTarget.value })}
        />
        {start.error && field === null && (
          <p className={classes.refusal} role="alert">
            {errorWords(start.error)}
          </p>
        )}
        <Button type="submit" size="md" loading={start.isPending} disabled={!form.name.trim()}>
          Start the job
        </Button>
        <p className={classes.note}>
          Nothing moves by it: it proposes loads, and each is aimed and held by a person.
        </p>
      </form>
    </Modal>
  );
}

function grabKg({ material, grab_m3 }: JobForm): number {
  const found = Object.entries(MATERIALS).find(([known]) => known === material)?.[1];
  return grab_m3 * (found?.density_kg_per_m3 ?? 0);
}

function materialWords(name: string, grab_m3: number): string {
  const found = Object.entries(MATERIALS).find(([known]) => known === name)?.[1];
  if (!found) return "";
  const { density_kg_per_m3, repose_deg, grain_mm, source } = found;
  return (
    `${fixed(density_kg_per_m3, 0)} kg/m³, rests at ${fixed(repose_deg, 0)}°, ` +
    `grains of ${fixed(grain_mm, grain_mm < 1 ? 1 : 0)} mm (${source}). ` +
    `A grab weighs ${fixed(grab_m3 * density_kg_per_m3, 0)} kg.`
  );
}
