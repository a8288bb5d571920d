import { NumberInput, SegmentedControl } from "@mantine/core";
import type { Schema } from "../../session/client";
import type { Machine } from "../../session/live";
import { metres, signed } from "../../words/format";
import classes from "../Panel.module.css";
import { PaceSlider } from "./PaceSlider";
import { SavedTargets } from "./SavedTargets";
import { fromPolar, NUDGE_M, type Target } from "./target";

type Props = {
  machine: Machine;
  mode: "2d" | "3d";
  onMode: (mode: "2d" | "3d") => void;
  target: Target | null;
  onTarget: (target: Target) => void;
  /** Whether one of the number fields has the keyboard. */
  onEditing: (isEditing: boolean) => void;
  problem: string | null;
  pace_ratio: number;
  onPace: (pace_ratio: number) => void;
};

const MODES = [
  { value: "2d", label: "2D arm plane" },
  { value: "3d", label: "3D with cabin" },
];

const DEGREES = 180 / Math.PI;
const FIRST_RANGE_M = 9;
/** What policies are trained for at most; the present one may do less, and says so. */
const HEIGHTS_M = { min: -1, max: 3 };

/** Where to throw: by a click in the view, by numbers, or by arrow keys. */
export function TargetStep(props: Props) {
  const { machine, mode, onMode, target, onTarget, onEditing, problem } = props;
  const reach = machine.reach.modes.find((other) => other.mode === mode);
  const range_m = target?.range_m ?? FIRST_RANGE_M;
  const azimuth_rad = target?.azimuth_rad ?? 0;
  const z_m = target?.z_m ?? 0;
  const common = { size: "sm" as const, decimalScale: 2, allowedDecimalSeparators: [".", ","] };
  return (
    <>
      <SegmentedControl
        fullWidth
        aria-label="How to throw"
        data={MODES}
        value={mode}
        onChange={(value) => onMode(value as "2d" | "3d")}
        mb={10}
      />
      <fieldset
        className={classes.fields}
        aria-label="Target in numbers"
        onFocus={() => onEditing(true)}
        onBlur={(event) => onEditing(event.currentTarget.contains(event.relatedTarget))}
      >
        <NumberInput
          {...common}
          label="Range, m"
          value={target ? round(range_m, 2) : ""}
          placeholder="click"
          min={0.5}
          max={60}
          step={NUDGE_M}
          onChange={(value) => isNumber(value) && onTarget(fromPolar(value, azimuth_rad, z_m))}
        />
        <NumberInput
          {...common}
          label="Azimuth, °"
          value={target ? round(azimuth_rad * DEGREES, 2) : ""}
          placeholder="left +"
          min={-180}
          max={180}
          step={0.5}
          onChange={(value) =>
            isNumber(value) && onTarget(fromPolar(range_m, value / DEGREES, z_m))
          }
        />
        <NumberInput
          {...common}
          label="Height, m"
          value={target ? round(z_m, 2) : ""}
          placeholder="0.00"
          min={HEIGHTS_M.min}
          max={HEIGHTS_M.max}
          step={NUDGE_M}
          onChange={(value) => isNumber(value) && onTarget(fromPolar(range_m, azimuth_rad, value))}
        />
      </fieldset>
      {problem && (
        <p className={classes.refusal} role="alert">
          {problem}
        </p>
      )}
      <p className={classes.note}>
        Click or tap the ground or an object, or type. Arrow keys move the target by 5 cm.
        {reach && ` ${reachWords(reach)}`}
      </p>
      <SavedTargets machineId={machine.machine_id} target={target} onTarget={onTarget} />
      <PaceSlider
        pace_ratio={props.pace_ratio}
        isHeeded={reach?.has_pace ?? false}
        onPace={props.onPace}
      />
    </>
  );
}

/** "2D reaches 5.50 m to 10.90 m on the ground, 9.20 m at +3.00 m; heights −1.00 to +3.00 m." */
export function reachWords(reach: Schema["ModeReach"]): string {
  const ranges = `${metres(reach.range_min_m)} to ${metres(reach.range_max_m)} on the ground`;
  const isFlat = reach.height_min_m === 0 && reach.height_max_m === 0;
  const heights = isFlat
    ? " only"
    : `, ${metres(reach.raised_range_max_m)} at ${signed(reach.height_max_m)} m; ` +
      `heights ${signed(reach.height_min_m)} to ${signed(reach.height_max_m)} m`;
  return `${reach.mode.toUpperCase()} reaches ${ranges}${heights}.`;
}

function isNumber(value: number | string): value is number {
  return typeof value === "number" && Number.isFinite(value);
}

function round(value: number, digits: number): number {
  return Number(value.toFixed(digits));
}
