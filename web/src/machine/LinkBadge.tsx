import { Tooltip } from "@mantine/core";
import type { Machine } from "../session/live";
import classes from "./LinkBadge.module.css";
import { linkQuality } from "./phase";

const BARS = [
  { x: 1, height: 4 },
  { x: 6, height: 8 },
  { x: 11, height: 12 },
];

type Props = { machine: Machine; isLive: boolean };

/** Link between server and machine: three bars and the last round trip; unknown while the server is away. */
export function LinkBadge({ machine, isLive }: Props) {
  if (!isLive) return <span className={classes.link}>link unknown</span>;
  const { bars, words } = linkQuality(machine);
  const rate = machine.link.state_rate_hz;
  const detail = `Link to ${machine.machine_id}: ${words}${rate ? `, ${rate.toFixed(0)} states/s` : ""}`;
  return (
    <Tooltip label={detail}>
      <div className={classes.link} role="img" aria-label={detail}>
        <svg width="16" height="14" viewBox="0 0 16 14" aria-hidden="true">
          {BARS.map((bar, index) => (
            <rect
              key={bar.x}
              x={bar.x}
              y={13 - bar.height}
              width="3.5"
              height={bar.height}
              className={index < bars ? classes.on : classes.off}
            />
          ))}
        </svg>
        <span>{words}</span>
      </div>
    </Tooltip>
  );
}
