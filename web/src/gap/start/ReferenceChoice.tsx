import { SegmentedControl, TextInput } from "@mantine/core";
import { useState } from "react";
import { errorWords } from "../../words/errors";
import { count } from "../../words/format";
import { useKeptReference, useThrowsToDiagnose } from "../useGap";
import classes from "./StartPanel.module.css";
import { ThrowPicker } from "./ThrowPicker";
import type { Wish } from "./wish";

type Props = {
  machineId: string;
  against: Wish["against"];
  onAgainst: (against: Wish["against"]) => void;
  /** Throws to diagnose; they cannot be compared with. */
  diagnosed: ReadonlySet<string>;
  chosen: ReadonlySet<string>;
  onChange: (chosen: ReadonlySet<string>) => void;
};

const NOTES = {
  machine: "Tick throws from when it was healthy: smaller effects show.",
  type: "Healthy machines of this type. They differ, so small effects stay hidden.",
};

/** What the throws are compared with: kept reference throws, ticked ones, or the machine's type. */
export function ReferenceChoice({ against, onAgainst, ...more }: Props) {
  return (
    <fieldset className={classes.group}>
      <legend>Compare with</legend>
      <SegmentedControl
        fullWidth
        orientation="vertical"
        aria-label="Compare with"
        data={[
          { value: "kept", label: "Kept throws" },
          { value: "machine", label: "This machine" },
          { value: "type", label: "Machine type" },
        ]}
        value={against}
        onChange={(value) => onAgainst(value as Wish["against"])}
      />
      {against === "kept" ? (
        <KeptThrows machineId={more.machineId} />
      ) : (
        <p className={classes.note}>{NOTES[against]}</p>
      )}
      {against === "machine" && <HealthyThrows {...more} />}
    </fieldset>
  );
}

/** Which reference throws commissioning has kept. */
function KeptThrows({ machineId }: { machineId: string }) {
  const kept = useKeptReference(machineId);
  if (kept.isError) return <p className={classes.error}>{errorWords(kept.error)}</p>;
  if (!kept.data) return null;
  return (
    <p className={classes.note} data-problem={!kept.data.is_used || undefined}>
      {kept.data.words}
      {!kept.data.is_used && " It is compared with its type, and only large effects show."}
    </p>
  );
}

type ThrowsProps = Pick<Props, "machineId" | "diagnosed" | "chosen" | "onChange">;

function HealthyThrows({ machineId, diagnosed, chosen, onChange }: ThrowsProps) {
  const [until, setUntil] = useState("");
  const throws = useThrowsToDiagnose(machineId, until || undefined);
  if (throws.isError) return <p className={classes.error}>{errorWords(throws.error)}</p>;
  const rows = (throws.data ?? []).filter((row) => !diagnosed.has(row.throw_id));
  const ticked = [...chosen].filter((id) => !diagnosed.has(id)).length;
  return (
    <>
      <TextInput
        type="date"
        aria-label="Healthy throws up to"
        leftSection={<span className={classes.prefix}>up to</span>}
        leftSectionWidth={48}
        value={until}
        onChange={(event) => setUntil(event.currentTarget.value)}
      />
      {rows.length > 0 ? (
        <ThrowPicker
          label="Healthy throws to compare with"
          throws={rows}
          chosen={chosen}
          onChange={onChange}
        />
      ) : (
        throws.isSuccess && (
          <p className={classes.note} data-problem>
            No {until ? "" : "other "}throws with a log{until ? " up to that day" : ""}. Record some
            while the machine is healthy, best after commissioning.
          </p>
        )
      )}
      {ticked > 0 && <p className={classes.note}>{count(ticked, "healthy throw")} ticked.</p>}
    </>
  );
}
