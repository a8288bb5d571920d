import { Slider } from "@mantine/core";
import { useEffect, useState } from "react";
import classes from "./PaceSlider.module.css";
import { PACE_STEP, paceWords } from "./pace";

type Props = { pace_ratio: number; isHeeded: boolean; onPace: (pace_ratio: number) => void };

const MARKS = [
  { value: 0, label: "careful" },
  { value: 1, label: "fast" },
];

/** Careful to fast: less speed and spread, or less time. Sent with the plan when it is let go. */
export function PaceSlider({ pace_ratio, isHeeded, onPace }: Props) {
  const [shown, setShown] = useState(pace_ratio);
  useEffect(() => setShown(pace_ratio), [pace_ratio]);
  return (
    <div className={classes.pace}>
      <div className={classes.line}>
        <span id="pace-label">Pace</span>
        <output className={classes.value}>
          {isHeeded ? paceWords(shown) : "this policy has one pace"}
        </output>
      </div>
      <Slider
        thumbProps={{ "aria-labelledby": "pace-label" }}
        thumbLabel="Pace"
        min={0}
        max={1}
        step={PACE_STEP}
        marks={MARKS}
        label={null}
        size={6}
        thumbSize={26}
        disabled={!isHeeded}
        value={shown}
        onChange={setShown}
        onChangeEnd={onPace}
      />
    </div>
  );
}
