import { SegmentedControl } from "@mantine/core";
import { useMemo, useState } from "react";
import { TimeSeries } from "../charts/TimeSeries";
import type { Schema } from "../session/client";
import { panelsOf, type Quantity } from "./panels";
import classes from "./SeriesGrid.module.css";

type Props = { series: Schema["ThrowSeries"]; at_s: number; onSeek: (at_s: number) => void };

/** All series of a throw, one cursor through all of them. */
export function SeriesGrid({ series, at_s, onSeek }: Props) {
  const [quantity, setQuantity] = useState<Quantity>("velocity");
  const panels = useMemo(() => panelsOf(series, quantity), [series, quantity]);
  return (
    <section aria-label="Time series" className={classes.section}>
      <div className={classes.head}>
        <SegmentedControl
          size="xs"
          aria-label="Joint quantity"
          data={[
            { value: "velocity", label: "Velocity" },
            { value: "position", label: "Position" },
          ]}
          value={quantity}
          onChange={(value) => setQuantity(value as Quantity)}
        />
        <span className={classes.hint}>
          Click to move the replay, drag to zoom, double click to zoom out.
        </span>
      </div>
      <div className={classes.grid}>
        {panels.map((panel) => (
          <div key={panel.id} className={classes.cell}>
            <TimeSeries
              title={panel.title}
              unit={panel.unit}
              t_s={series.t_s}
              lines={panel.lines}
              bands={series.phases}
              at_s={at_s}
              onSeek={onSeek}
            />
          </div>
        ))}
      </div>
    </section>
  );
}
