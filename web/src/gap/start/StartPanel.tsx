import { Button, NumberInput, SegmentedControl } from "@mantine/core";
import { useState } from "react";
import type { Schema } from "../../session/client";
import { useMay } from "../../session/useSession";
import { errorWords } from "../../words/errors";
import { count } from "../../words/format";
import { useFocusKept } from "../useFocusKept";
import { useGapActions, useThrowsToDiagnose } from "../useGap";
import { ReferenceChoice } from "./ReferenceChoice";
import classes from "./StartPanel.module.css";
import { ThrowPicker } from "./ThrowPicker";
import { diagnosedOf, fittingOf, MIN_THROWS, type Wish, wishOf } from "./wish";

const FIRST: Wish = { by: "newest", count: 12, mode: "any", against: "kept", materialCm: null };

type Props = { machineId: string; onStarted: (runId: string) => void };

/** Which throws to diagnose, what to compare them with, and the button that starts it. */
export function StartPanel({ machineId, onStarted }: Props) {
  const [wish, setWish] = useState<Wish>(FIRST);
  const [chosen, setChosen] = useState<ReadonlySet<string>>(new Set());
  const [healthy, setHealthy] = useState<ReadonlySet<string>>(new Set());
  const throws = useThrowsToDiagnose(machineId);
  const { start } = useGapActions(machineId);
  const mayRun = useMay("gap.run");
  const kept = useFocusKept<HTMLDivElement>();
  const all = throws.data ?? [];
  const diagnosed = diagnosedOf(wish, all, chosen);
  const { body, problem } = wishOf(wish, all, chosen, healthy);
  const submit = (event: React.FormEvent) => {
    event.preventDefault();
    if (body)
      start.mutate(body, { onSuccess: (run: Schema["GapRunRow"]) => onStarted(run.gap_run_id) });
  };
  return (
    <form className={classes.panel} onSubmit={submit} aria-label="New diagnosis">
      <h2>Diagnose {machineId}</h2>
      <SegmentedControl
        fullWidth
        aria-label="Which throws"
        data={[
          { value: "newest", label: "Newest" },
          { value: "hand", label: "By hand" },
        ]}
        value={wish.by}
        onChange={(by) => setWish({ ...wish, by: by as Wish["by"] })}
      />
      <div className={classes.fields}>
        <SegmentedControl
          aria-label="Mode"
          data={[
            { value: "any", label: "Both" },
            { value: "2d", label: "2D" },
            { value: "3d", label: "3D" },
          ]}
          value={wish.mode}
          onChange={(mode) => setWish({ ...wish, mode: mode as Wish["mode"] })}
        />
        {wish.by === "newest" && (
          <NumberInput
            aria-label="How many throws"
            suffix=" throws"
            min={MIN_THROWS}
            max={60}
            value={wish.count}
            onChange={(value) => typeof value === "number" && setWish({ ...wish, count: value })}
          />
        )}
      </div>
      {wish.by === "hand" && (
        <ThrowPicker
          label="Throws that can be diagnosed"
          throws={fittingOf(wish, all)}
          chosen={chosen}
          onChange={setChosen}
        />
      )}
      {throws.isError && <p className={classes.error}>{errorWords(throws.error)}</p>}
      {all.length >= MIN_THROWS && (
        <p className={classes.note} aria-live="polite">
          {wish.by === "hand" && `${diagnosed.size} ticked. `}
          {count(all.length, "throw")} of this machine landed and have a log.
        </p>
      )}
      <ReferenceChoice
        machineId={machineId}
        against={wish.against}
        onAgainst={(against) => setWish({ ...wish, against })}
        diagnosed={diagnosed}
        chosen={healthy}
        onChange={setHealthy}
      />
      <fieldset className={classes.group}>
        <legend>What matters</legend>
        <NumberInput
          aria-label="Least move of the impact"
          placeholder="Every effect counts"
          suffix=" cm of impact"
          min={1}
          max={100}
          allowDecimal={false}
          value={wish.materialCm ?? ""}
          onChange={(value) =>
            setWish({ ...wish, materialCm: typeof value === "number" ? value : null })
          }
        />
        <p className={classes.note}>
          {wish.materialCm === null
            ? "Every effect that shows is named."
            : `An effect that moves the impact by less than ${wish.materialCm} cm is seen, not named. Sensors and pose always count.`}
        </p>
      </fieldset>
      {throws.isSuccess && problem !== null && (
        <p className={classes.note} data-problem>
          {problem}
        </p>
      )}
      <div {...kept}>
        <Button
          type="submit"
          fullWidth
          loading={start.isPending}
          disabled={!mayRun || body === null}
        >
          Start diagnosis
        </Button>
      </div>
      {!mayRun && <p className={classes.note}>Your role may look, not start. Ask an operator.</p>}
      {start.isError && (
        <p className={classes.error} role="alert">
          {errorWords(start.error)}
        </p>
      )}
    </form>
  );
}
