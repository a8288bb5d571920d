import { ActionIcon } from "@mantine/core";
import { IconPlayerPauseFilled, IconPlayerPlayFilled } from "@tabler/icons-react";
import type { Band } from "../charts/seriesPlot";
import { fixed } from "../words/format";
import { phaseAt } from "./panels";
import classes from "./Scrubber.module.css";

type Props = {
  duration_s: number;
  at_s: number;
  isPlaying: boolean;
  bands: readonly Band[];
  onSeek: (at_s: number) => void;
  onToggle: () => void;
};

const STEP_S = 0.02;

/** Time of the replay over its phases; arrow keys step by 20 ms. */
export function Scrubber({ duration_s, at_s, isPlaying, bands, onSeek, onToggle }: Props) {
  const shown = bands.filter((band) => band.name !== "flight");
  const flight = bands.find((band) => band.name === "flight");
  const phase = phaseAt(bands, at_s);
  const share = (value_s: number) => `${(100 * value_s) / Math.max(duration_s, 0.01)}%`;
  return (
    <div className={classes.scrubber}>
      <ActionIcon
        size={44}
        variant="default"
        aria-label={isPlaying ? "Pause the replay" : "Play the replay"}
        onClick={onToggle}
        data-testid="play"
      >
        {isPlaying ? <IconPlayerPauseFilled size={20} /> : <IconPlayerPlayFilled size={20} />}
      </ActionIcon>
      <div className={classes.track}>
        <div className={classes.bands} aria-hidden="true">
          {shown.map((band, index) => (
            <span
              key={`${band.name} ${band.start_s}`}
              className={classes.band}
              data-odd={index % 2 === 1 || undefined}
              style={{ left: share(band.start_s), width: share(band.end_s - band.start_s) }}
            >
              <span className={classes.name}>{band.name}</span>
            </span>
          ))}
          {flight && (
            <span
              className={classes.flight}
              style={{ left: share(flight.start_s), width: share(flight.end_s - flight.start_s) }}
            />
          )}
        </div>
        <input
          type="range"
          className={classes.range}
          min={0}
          max={duration_s}
          step={STEP_S}
          value={at_s}
          aria-label="Time of the replay, seconds"
          aria-valuetext={`${fixed(at_s)} of ${fixed(duration_s)} seconds, ${phase}`}
          onChange={(event) => onSeek(Number(event.currentTarget.value))}
        />
      </div>
      <span className={classes.time}>
        {fixed(at_s)} / {fixed(duration_s)} s<span className={classes.phase}>{phase}</span>
      </span>
    </div>
  );
}
