import { Select } from "@mantine/core";
import { useMemo, useState } from "react";
import { TimeSeries } from "../charts/TimeSeries";
import classes from "./GapPlots.module.css";
import { overlaysOf } from "./plots";

const SHOWN_COUNT = 4;
const NO_BANDS: readonly never[] = [];

/** Measured against the twin before and after, and what is left of each; one moment through all. */
export function GapPlots({ plots }: { plots: Record<string, unknown> }) {
  const overlays = useMemo(() => overlaysOf(plots), [plots]);
  const [first, setFirst] = useState(0);
  const [at_s, setAt] = useState(0);
  const pages = Math.ceil(overlays.length / SHOWN_COUNT);
  const shown = overlays.slice(first * SHOWN_COUNT, (first + 1) * SHOWN_COUNT);
  if (overlays.length === 0) {
    return <p className={classes.hint}>This diagnosis kept no series.</p>;
  }
  return (
    <>
      <div className={classes.head}>
        {pages > 1 && (
          <Select
            size="xs"
            w={260}
            aria-label="Which series"
            allowDeselect={false}
            value={String(first)}
            onChange={(value) => setFirst(Number(value))}
            data={Array.from({ length: pages }, (_, index) => ({
              value: String(index),
              label: namesOf(overlays.slice(index * SHOWN_COUNT, (index + 1) * SHOWN_COUNT)),
            }))}
          />
        )}
        <span className={classes.hint}>
          Click to mark a moment in all, drag to zoom, double click to zoom out.
        </span>
      </div>
      <div className={classes.grid}>
        {shown.flatMap((overlay) => [
          <div key={overlay.name} className={classes.cell}>
            <TimeSeries
              title={overlay.name}
              unit={overlay.unit}
              t_s={overlay.x}
              lines={overlay.lines}
              bands={NO_BANDS}
              at_s={at_s}
              onSeek={setAt}
            />
          </div>,
          overlay.left.length > 0 && (
            <div key={`${overlay.name} left`} className={classes.cell}>
              <TimeSeries
                title={`${overlay.name}: what is left`}
                unit={overlay.unit}
                t_s={overlay.x}
                lines={overlay.left}
                bands={NO_BANDS}
                at_s={at_s}
                onSeek={setAt}
              />
            </div>
          ),
        ])}
      </div>
    </>
  );
}

function namesOf(overlays: readonly { name: string }[]): string {
  const [first, last] = [overlays[0]?.name ?? "", overlays.at(-1)?.name ?? ""];
  return first === last ? first : `${first} to ${last}`;
}
