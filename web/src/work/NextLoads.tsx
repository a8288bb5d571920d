import { Button, NumberInput, Progress } from "@mantine/core";
import { Link } from "@tanstack/react-router";
import { useState } from "react";
import { aimSearch } from "../operate/target/aimAddress";
import { paceWord } from "../operate/target/pace";
import { fromPoint } from "../operate/target/target";
import { errorWords } from "../words/errors";
import { bearingWords, heightWords, metres } from "../words/format";
import type { Job, Proposal } from "./job";
import type { Point } from "./rectangle";
import type { useJobChange } from "./useJobs";
import classes from "./Work.module.css";
import { noPlanWords, reasonWords } from "./words";

type Props = {
  job: Job;
  mayEdit: boolean;
  change: ReturnType<typeof useJobChange>;
  moving: number | null;
  onMoving: (proposal: number | null) => void;
};

/** The next three loads with their reasons: aim at one, pass it over, or put it elsewhere. */
export function NextLoads({ job, mayEdit, change, moving, onMoving }: Props) {
  const why = noPlanWords(job);
  const failed = failedOf(change);
  return (
    <section className={classes.next} aria-label="Next loads">
      <h3>Next loads</h3>
      {job.plan_state === "planning" && (
        <div role="status">
          <p className={classes.note}>Planning the next loads…</p>
          <Progress value={100} animated aria-label="Planning" />
        </div>
      )}
      {why && (
        <p className={job.plan_state === "failed" ? classes.refusal : classes.note} role="status">
          {why}
        </p>
      )}
      <ol className={classes.proposals}>
        {job.next.map((one) => (
          <ProposalItem
            key={one.proposal_count}
            job={job}
            proposal={one}
            mayEdit={mayEdit}
            isBusy={change.isPending}
            isMoving={moving === one.proposal_count}
            problem={failed === one.proposal_count ? errorWords(change.error) : null}
            onSkip={() => {
              onMoving(null);
              change.mutate({ kind: "skip", body: { proposal_count: one.proposal_count } });
            }}
            onMoving={(is) => onMoving(is ? one.proposal_count : null)}
            onPlace={([x_m, y_m]) =>
              change.mutate(
                { kind: "move", body: { proposal_count: one.proposal_count, x_m, y_m } },
                { onSuccess: () => onMoving(null) },
              )
            }
          />
        ))}
      </ol>
      {job.next.length > 0 && (
        <p className={classes.note}>
          {job.landing_by === "measured"
            ? "Spill is reckoned with the scatter of this machine's measured throws."
            : "Spill is reckoned with the scatter of virtual machines until loads are measured."}
          {!mayEdit && " Your role may look. Operators aim, skip and move."}
        </p>
      )}
    </section>
  );
}

/** The proposal whose change was refused. */
function failedOf({ isError, variables }: Props["change"]): number | null {
  if (!isError || (variables?.kind !== "skip" && variables?.kind !== "move")) return null;
  return variables.body.proposal_count;
}

type ItemProps = {
  job: Job;
  proposal: Proposal;
  mayEdit: boolean;
  isBusy: boolean;
  isMoving: boolean;
  problem: string | null;
  onSkip: () => void;
  onMoving: (isMoving: boolean) => void;
  onPlace: (point: Point) => void;
};

function ProposalItem(props: ItemProps) {
  const { job, proposal, mayEdit, isBusy, isMoving, problem, onSkip, onMoving, onPlace } = props;
  const { proposal_count, mode, pace_ratio, x_m, y_m, z_m, sentence } = proposal;
  const target = fromPoint(x_m, y_m, z_m);
  return (
    <li className={classes.proposal} data-proposal={proposal_count}>
      <span className={classes.mark} aria-hidden>
        {proposal_count}
      </span>
      <div>
        <p className={classes.sentence}>{reasonWords(sentence)}</p>
        <p className={classes.note}>
          {mode.toUpperCase()}, {paceWord(pace_ratio)}, {metres(target.range_m)},{" "}
          {bearingWords(target.azimuth_rad)}
          {heightWords(z_m)}
        </p>
        {mayEdit && (
          <div className={classes.actions}>
            <Button
              size="sm"
              variant={proposal_count === 1 ? "filled" : "default"}
              aria-label={`Aim at load ${proposal_count}`}
              renderRoot={(root) => (
                <Link
                  to="/operate"
                  search={{ ...aimSearch(job.machine_id, mode, target), pace: pace_ratio }}
                  {...root}
                />
              )}
            >
              Aim
            </Button>
            <Button
              size="sm"
              variant="default"
              disabled={isBusy}
              aria-label={`Skip load ${proposal_count}`}
              onClick={onSkip}
            >
              Skip
            </Button>
            <Button
              size="sm"
              variant="default"
              disabled={isBusy}
              aria-label={`Move load ${proposal_count}`}
              aria-expanded={isMoving}
              onClick={() => onMoving(!isMoving)}
            >
              Move
            </Button>
          </div>
        )}
        {problem && (
          <p className={classes.refusal} role="alert">
            {problem}
          </p>
        )}
        {isMoving && (
          <MoveForm first={[x_m, y_m]} onPlace={onPlace} onCancel={() => onMoving(false)} />
        )}
      </div>
    </li>
  );
}

type MoveProps = { first: Point; onPlace: (point: Point) => void; onCancel: () => void };

/** The same as a click on the map, by keys. */
function MoveForm({ first, onPlace, onCancel }: MoveProps) {
  const [x, setX] = useState(Number(first[0].toFixed(2)));
  const [y, setY] = useState(Number(first[1].toFixed(2)));
  const number = (label: string, value: number, set: (value: number) => void) => (
    <NumberInput
      size="sm"
      label={label}
      decimalScale={2}
      step={0.1}
      min={-60}
      max={60}
      allowedDecimalSeparators={[".", ","]}
      value={value}
      onChange={(next) => typeof next === "number" && set(next)}
    />
  );
  const submit = (event: React.FormEvent) => {
    event.preventDefault();
    onPlace([x, y]);
  };
  return (
    <form className={classes.move} onSubmit={submit} aria-label="Where it shall go">
      <p className={classes.note}>Click the map, or type: x forward, y left of the machine.</p>
      <div className={classes.fields}>
        {number("x, m", x, setX)}
        {number("y, m", y, setY)}
      </div>
      <div className={classes.actions}>
        <Button type="submit" size="sm">
          Put it there
        </Button>
        <Button size="sm" variant="default" onClick={onCancel}>
          Cancel
        </Button>
      </div>
    </form>
  );
}
