import { Button, Group, NumberInput, TextInput } from "@mantine/core";
import { useMutation, useQueryClient } from "@tanstack/react-query";
import { useEffect, useRef, useState } from "react";
import { LandingPlot } from "../charts/LandingPlot";
import { api, take } from "../session/client";
import type { Plan, Throw } from "../session/live";
import { useLive } from "../session/liveStore";
import { errorWords } from "../words/errors";
import classes from "./MarkImpact.module.css";
import { errorOf, type LandingPoint, measuredOf, predictedOf } from "./marking";

/** The plot is at least this large about the target, m, so that a miss can be clicked. */
const PLOT_LEAST_M = 0.6;

type Props = { thrown: Throw; plan: Plan | null; onDone: () => void };

const round = (value_m: number) => Number(value_m.toFixed(2));

/** Where the operator saw it come down: a click or numbers; a new record, the earlier ones stay. */
export function MarkImpact({ thrown, plan, onDone }: Props) {
  const known = measuredOf(thrown) ?? predictedOf(plan);
  const [along_m, setAlong] = useState<number | string>(known ? round(known.downrange_m) : "");
  const [across_m, setAcross] = useState<number | string>(known ? round(known.crossrange_m) : "");
  const [note, setNote] = useState("");
  const set = (point: LandingPoint) => {
    setAlong(round(point.downrange_m));
    setAcross(round(point.crossrange_m));
  };
  usePickedPoint(thrown, set);
  const mark = useMark(thrown.throw_id, onDone);
  const isReady = typeof along_m === "number" && typeof across_m === "number";
  const submit = (event: React.FormEvent) => {
    event.preventDefault();
    if (isReady) mark.mutate({ downrange_error_m: along_m, crossrange_error_m: across_m, note });
  };
  const common = { decimalScale: 2, step: 0.05, min: -60, max: 60, required: true } as const;
  return (
    <form onSubmit={submit} className={classes.form} aria-label="Mark impact">
      <p className={classes.how}>
        Click or tap where it came down, in the plot or on the ground of the 3D view, or type it.
      </p>
      <LandingPlot
        ellipse={plan?.prediction?.ellipse ?? null}
        predicted={predictedOf(plan)}
        measured={isReady ? { downrange_m: along_m, crossrange_m: across_m } : null}
        least_m={PLOT_LEAST_M}
        onPick={set}
      />
      <Group grow gap={8}>
        <NumberInput
          {...common}
          label="Long +, short −, m"
          value={along_m}
          onChange={setAlong}
          data-autofocus
        />
        <NumberInput {...common} label="Left +, right −, m" value={across_m} onChange={setAcross} />
      </Group>
      <TextInput
        mt={8}
        label="Note"
        placeholder="how it was measured"
        value={note}
        maxLength={500}
        onChange={(event) => setNote(event.currentTarget.value)}
      />
      {mark.isError && (
        <p className={classes.error} role="alert">
          {errorWords(mark.error)}
        </p>
      )}
      <Group mt={10} gap={8}>
        <Button type="submit" disabled={!isReady} loading={mark.isPending}>
          Save as a new record
        </Button>
        <Button variant="default" onClick={onDone}>
          Cancel
        </Button>
      </Group>
    </form>
  );
}

/** Clicks in the 3D view since the form was opened. */
function usePickedPoint(thrown: Throw, set: (point: LandingPoint) => void): void {
  const picked = useLive((live) => live.picked[thrown.machine_id]);
  const seen = useRef(picked);
  const latest = useRef(set);
  latest.current = set;
  useEffect(() => {
    if (!picked || picked === seen.current) return;
    seen.current = picked;
    latest.current(errorOf(picked, thrown.target));
  }, [picked, thrown.target]);
}

function useMark(throwId: string, onDone: () => void) {
  const client = useQueryClient();
  return useMutation({
    mutationFn: (body: { downrange_error_m: number; crossrange_error_m: number; note: string }) =>
      take(
        api.POST("/api/v1/throws/{throw_id}/impacts", {
          params: { path: { throw_id: throwId } },
          body,
        }),
      ),
    onSuccess: async () => {
      await client.invalidateQueries({ queryKey: ["throw", throwId] });
      await client.invalidateQueries({ queryKey: ["throws"] });
      onDone();
    },
  });
}
