/**
 * A machine's view without what changes in every message and nobody reads as a number: clocks and joint
 * positions (the 3D view draws those), and link figures finer than they are shown.
 */

import type { Schema } from "./client";

type Machine = Schema["MachineView"];

function round(value: number | null, step: number): number | null {
  return value === null ? null : Math.round(value / step) * step;
}

/** Whole seconds: the lamp counts in seconds. */
function wholeSecond(iso: string | null): string | null {
  return iso === null ? null : `${iso.slice(0, 19)}Z`;
}

export function quiet(machine: Machine): Machine {
  const { link, state } = machine;
  return {
    ...machine,
    lamp_text: "",
    link: {
      ...link,
      last_seen_utc: wholeSecond(link.last_seen_utc),
      last_seen_age_s: null,
      round_trip_s: round(link.round_trip_s, 0.001),
      state_rate_hz: round(link.state_rate_hz, 1),
    },
    state: state && {
      ...state,
      t_mono_ns: 0,
      joint_position_rad_m: [0, 0, 0, 0, 0, 0],
      heartbeat_age_s: null,
      late_tick_ratio: 0,
    },
  };
}
