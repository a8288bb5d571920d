import { Slider } from "@mantine/core";
import { useEffect, useState } from "react";
import classes from "./PaceSlider.module.css";
import { PACE_STEP, paceWords } from "./pace";

type Props = { pace_ratio: number; isHeeded: boolean; onPace: (pace_ratio: number) => void };

/** Careful to fast: less speed and spread, or less time. Sent with the plan when it is let go. */
export function PaceSlider({ pace_ratio, isHeeded, onPace }: Props) {
  const [shown, setShown] = useState(pace_ratio);
  useEffect(() => setShown(pace_ratio), [pace_ratio]);
  return (
    <div className={classes.pace}>
      <div className={classes.line}>
        <span>Pace</span>
        <output className={classes.value}>
          {isHeeded ? paceWords(shown) : "this policy has one pace"}
        </output>
      </div>
      <Slider
        thumbLabel="Pace"
        min={0}
        max={1}
        step={PACE_STEP}
        label={null}
        size={6}
        thumbSize={26}
        disabled={!isHeeded}
        value={shown}
        onChange={setShown}
        onChangeEnd={onPace}
      />
      <div className={classes.ends} aria-hidden="true">
        <span>careful</span>
        <span>fast</span>
      </div>
    </div>
  );
}
