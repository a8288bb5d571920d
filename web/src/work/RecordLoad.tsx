import { Button, Modal, NativeSelect, NumberInput } from "@mantine/core";
import { useState } from "react";
import { errorWords } from "../words/errors";
import { bearingWords, metres } from "../words/format";
import { shortStamp } from "../words/time";
import type { Job } from "./job";
import { type useJobChange, useLandedThrows } from "./useJobs";
import classes from "./Work.module.css";

type Props = { job: Job; change: ReturnType<typeof useJobChange>; onClose: () => void };

const BY_HAND = "";

/** A load that was not thrown at a proposal: a throw of this machine, or one that fell at a place. */
export function RecordLoad({ job, change, onClose }: Props) {
  const throws = useLandedThrows(job.machine_id);
  const known = new Set(job.loads.map((load) => load.throw_id));
  const rows = (throws.data?.rows ?? []).filter(
    (row) => !known.has(row.throw_id) && row.created_utc >= job.created_utc,
  );
  const [chosen, setChosen] = useState<string | null>(null);
  const throwId = chosen ?? rows[0]?.throw_id ?? BY_HAND;
  const [volume_m3, setVolume] = useState(job.file.grab_m3);
  const [x_m, setX] = useState<number | "">("");
  const [y_m, setY] = useState<number | "">("");
  const isByHand = throwId === BY_HAND;
  const isReady = !isByHand || (x_m !== "" && y_m !== "");
  const submit = (event: React.FormEvent) => {
    event.preventDefault();
    if (!isReady) return;
    const body =
      x_m !== "" && y_m !== "" && isByHand
        ? { x_m, y_m, volume_m3 }
        : { throw_id: throwId, volume_m3 };
    change.mutate({ kind: "loads", body }, { onSuccess: onClose });
  };
  const place = (label: string, value: number | "", set: (value: number) => void) => (
    <NumberInput
      size="md"
      label={label}
      decimalScale={2}
      step={0.1}
      min={-60}
      max={60}
      allowedDecimalSeparators={[".", ","]}
      required
      value={value}
      onChange={(next) => typeof next === "number" && set(next)}
    />
  );
  return (
    <Modal opened onClose={onClose} title="Record a load" centered>
      <form className={classes.dialog} onSubmit={submit}>
        <p className={classes.text}>
          Throws at the next loads are recorded by themselves. Record here what was thrown
          elsewhere, or tipped by something else.
        </p>
        <NativeSelect
          size="md"
          label="Throw"
          data={[
            ...rows.map((row) => ({
              value: row.throw_id,
              label: `${shortStamp(row.created_utc)}, ${metres(row.target.range_m)}, ${bearingWords(row.target.azimuth_rad)}`,
            })),
            { value: BY_HAND, label: "None: at a place" },
          ]}
          value={throwId}
          onChange={(event) => setChosen(event.currentTarget.value)}
        />
        {throws.isError && <p className={classes.refusal}>{errorWords(throws.error)}</p>}
        {isByHand && (
          <div className={classes.fields}>
            {place("x forward, m", x_m, setX)}
            {place("y left, m", y_m, setY)}
          </div>
        )}
        <NumberInput
          size="md"
          label="Volume"
          suffix=" m³"
          decimalScale={3}
          step={0.05}
          min={0.01}
          max={10}
          allowedDecimalSeparators={[".", ","]}
          value={volume_m3}
          onChange={(next) => typeof next === "number" && setVolume(next)}
        />
        {change.isError && (
          <p className={classes.refusal} role="alert">
            {errorWords(change.error)}
          </p>
        )}
        <Button type="submit" size="md" loading={change.isPending} disabled={!isReady}>
          Record it
        </Button>
      </form>
    </Modal>
  );
}
