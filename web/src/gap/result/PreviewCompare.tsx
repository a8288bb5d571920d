import { Button, NumberInput, SegmentedControl } from "@mantine/core";
import { useState } from "react";
import type { Schema } from "../../session/client";
import { errorWords } from "../../words/errors";
import { crossrangeWords, downrangeWords, metres, speed } from "../../words/format";
import { useFocusKept } from "../useFocusKept";
import { useGapPreview } from "../useGap";
import classes from "./PreviewCompare.module.css";

type Props = { machineId: string; runId: string; isInUse: boolean };

/** One target previewed without and with what was found: what applying would change, or has changed. */
export function PreviewCompare({ machineId, runId, isInUse }: Props) {
  const [mode, setMode] = useState<"2d" | "3d">("3d");
  const [range_m, setRange] = useState(9);
  const [azimuth_deg, setAzimuth] = useState(0);
  const preview = useGapPreview(machineId, runId);
  const kept = useFocusKept<HTMLDivElement>();
  const submit = (event: React.FormEvent) => {
    event.preventDefault();
    preview.mutate({ mode, range_m, azimuth_rad: (azimuth_deg * Math.PI) / 180 });
  };
  return (
    <form className={classes.form} onSubmit={submit} aria-label="Preview before and after">
      <div className={classes.fields}>
        <SegmentedControl
          aria-label="Mode of the preview"
          data={[
            { value: "2d", label: "2D" },
            { value: "3d", label: "3D" },
          ]}
          value={mode}
          onChange={(value) => setMode(value as "2d" | "3d")}
        />
        <NumberInput
          aria-label="Range, m"
          suffix=" m"
          w={104}
          min={0.5}
          max={60}
          step={0.5}
          decimalScale={2}
          value={range_m}
          onChange={(value) => typeof value === "number" && setRange(value)}
        />
        <NumberInput
          aria-label="Azimuth, degrees, left positive"
          suffix="°"
          w={88}
          min={-180}
          max={180}
          decimalScale={1}
          value={azimuth_deg}
          onChange={(value) => typeof value === "number" && setAzimuth(value)}
        />
        <div {...kept}>
          <Button type="submit" variant="default" loading={preview.isPending}>
            Preview both
          </Button>
        </div>
      </div>
      {preview.isError && (
        <p className={classes.problem} role="alert">
          {errorWords(preview.error)}
        </p>
      )}
      {preview.data && <Compared view={preview.data} isInUse={isInUse} />}
    </form>
  );
}

type Side = Schema["GapSideView"];
type Prediction = Schema["PredictionView"];

const LINES: readonly [string, (p: Prediction) => string][] = [
  ["Along", (p) => downrangeWords(p.downrange_error_m)],
  ["Across", (p) => crossrangeWords(p.crossrange_error_m)],
  ["Scatter along, 1 sigma", (p) => metres(p.ellipse?.sd_downrange_m)],
  ["Scatter across, 1 sigma", (p) => metres(p.ellipse?.sd_crossrange_m)],
  ["Release speed", (p) => speed(p.release_speed_m_per_s)],
];

type ComparedProps = { view: Schema["GapPreviewView"]; isInUse: boolean };

function Compared({ view, isInUse }: ComparedProps) {
  const { before, after } = view;
  return (
    <>
      <table className={classes.table}>
        <thead>
          <tr>
            <th scope="col">The twin says of {metres(view.target.range_m)}</th>
            <th scope="col">
              {isInUse ? "before" : "now"}, version {before.version_count}
            </th>
            <th scope="col">
              {isInUse ? `now, version ${after.version_count}` : "with the cause"}
            </th>
          </tr>
        </thead>
        <tbody>
          {LINES.map(([name, words]) => (
            <tr key={name}>
              <th scope="row">{name}</th>
              <td>{before.prediction ? words(before.prediction) : "no landing"}</td>
              <td>{after.prediction ? words(after.prediction) : "no landing"}</td>
            </tr>
          ))}
          <tr>
            <th scope="row">Refused</th>
            <td>{refusalWords(before)}</td>
            <td>{refusalWords(after)}</td>
          </tr>
        </tbody>
      </table>
      <p className={classes.note}>
        {view.is_machine_pose
          ? "From the pose in which the machine stands."
          : "The machine is not connected: from its pose for throwing."}
      </p>
    </>
  );
}

const refusalWords = (side: Side) =>
  side.refusals.length === 0 ? "no" : side.refusals.map((refusal) => refusal.detail).join(" ");
