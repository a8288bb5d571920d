import { Select } from "@mantine/core";
import { Link } from "@tanstack/react-router";
import { useMemo, useState } from "react";
import { TimeSeries } from "../../charts/TimeSeries";
import { zonedStamp } from "../../words/time";
import { SENTENCES } from "../words";
import classes from "./GapPlots.module.css";
import { type Overlay, overlaysOf } from "./plots";

const NO_BANDS: readonly never[] = [];

/** Measured against the twin before and after, and what is left of each; one moment through all. */
export function GapPlots({ plots }: { plots: Record<string, unknown> }) {
  const overlays = useMemo(() => overlaysOf(plots), [plots]);
  const groups = [...new Set(overlays.map((overlay) => overlay.group))];
  const [chosen, choose] = useState<string | null>(null);
  const [at_s, setAt] = useState(0);
  const group = chosen ?? groups[0];
  if (overlays.length === 0) {
    return <p className={classes.hint}>This diagnosis kept no series.</p>;
  }
  return (
    <>
      <div className={classes.head}>
        {groups.length > 1 && (
          <Select
            size="xs"
            w={220}
            aria-label="Which series"
            allowDeselect={false}
            data={groups}
            value={group}
            onChange={choose}
          />
        )}
        <span className={classes.hint}>
          Time in s. Click to mark a moment in all, drag to zoom, double click to zoom out.
        </span>
      </div>
      <div className={classes.grid}>
        {overlays
          .filter((overlay) => overlay.group === group)
          .flatMap((overlay) => [
            <div key={overlay.name} className={classes.cell}>
              <Source overlay={overlay} />
              <TimeSeries
                title={titleOf(overlay.name, overlay.unit)}
                unit=""
                t_s={overlay.x}
                lines={overlay.lines}
                bands={NO_BANDS}
                at_s={at_s}
                onSeek={setAt}
              />
            </div>,
            overlay.left.length > 0 && (
              <div key={`${overlay.name} left`} className={classes.cell}>
                <Source overlay={overlay} />
                <TimeSeries
                  title={titleOf(`${overlay.name}: ${SENTENCES.measured_minus_twin}`, overlay.unit)}
                  unit=""
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

/** Which throw a chart shows, with the way to it. */
function Source({ overlay: { throwId, thrownUtc } }: { overlay: Overlay }) {
  if (throwId === null) return null;
  return (
    <p className={classes.source}>
      <Link to="/throws/$throwId" params={{ throwId }}>
        {thrownUtc === null ? "Throw" : `Throw of ${zonedStamp(thrownUtc)}`}
      </Link>{" "}
      <code>{throwId}</code>
    </p>
  );
}

/** The unit stands here once, so that all values of the legend fit in one line. */
const titleOf = (name: string, unit: string) => (unit ? `${name}, ${unit}` : name);
