import { Button, NumberInput } from "@mantine/core";
import { useState } from "react";
import { errorWords } from "../words/errors";
import { usePlace } from "./useFleet";
import classes from "./YardMap.module.css";
import type { Place } from "./yardGeometry";

const DEGREES = 180 / Math.PI;
const FAR_M = 10_000;

type Typed = number | string;
type Props = { machineId: string; place: Place | null };

/** Where a machine stands in the yard. */
export function PlaceForm({ machineId, place }: Props) {
  const [x_m, setX] = useState<Typed>(place?.x_m ?? "");
  const [y_m, setY] = useState<Typed>(place?.y_m ?? "");
  const [heading, setHeading] = useState<Typed>(
    Number(((place?.heading_rad ?? 0) * DEGREES).toFixed(1)),
  );
  const { put, remove } = usePlace(machineId);
  const isWhole = [x_m, y_m, heading].every((value) => typeof value === "number");
  const submit = (event: React.FormEvent) => {
    event.preventDefault();
    if (!isWhole) return;
    put.mutate({ x_m: Number(x_m), y_m: Number(y_m), heading_rad: Number(heading) / DEGREES });
  };
  const number = (label: string, value: Typed, take: (value: Typed) => void, most: number) => (
    <NumberInput
      size="sm"
      className={classes.number}
      label={label}
      value={value}
      onChange={take}
      min={-most}
      max={most}
      clampBehavior="strict"
      decimalScale={2}
      allowedDecimalSeparators={[".", ","]}
    />
  );
  const error = put.error ?? remove.error;
  return (
    <form className={classes.form} onSubmit={submit} aria-label={`Place of ${machineId}`}>
      {number("Right, m", x_m, setX, FAR_M)}
      {number("Up, m", y_m, setY, FAR_M)}
      {number("Heading, ° left", heading, setHeading, 180)}
      <Button type="submit" size="sm" disabled={!isWhole} loading={put.isPending}>
        Place {machineId}
      </Button>
      {place && (
        <Button
          size="sm"
          variant="default"
          loading={remove.isPending}
          onClick={() => remove.mutate()}
        >
          Take off the plan
        </Button>
      )}
      <p className={classes.note}>
        From an origin of your choice, the same for all machines; heading 0 looks to the right.
      </p>
      {error && (
        <p className={classes.note} role="alert">
          {errorWords(error)}
        </p>
      )}
    </form>
  );
}
