/** The machine's lamp: which state it shows, in which words, and what follows from it. */

import type { Schema } from "../session/client";
import type { Machine } from "../session/live";
import { age } from "../words/format";
import { ageSeconds } from "../words/time";

export type MachinePhase = Schema["Lamp"];

/** How loud a state is: plain, active (accent), look (amber), alarm (red). */
export type Tone = "plain" | "active" | "look" | "alarm";

const WORDS: Record<MachinePhase, string> = {
  disarmed: "Disarmed",
  armed: "Armed",
  aligning: "Aligning",
  throwing: "Throwing",
  committed: "Committed",
  settling: "Settling",
  stopped: "Stopped",
  fault: "Fault",
  lost: "Lost",
  never_seen: "Never seen",
};

const TONES: Record<MachinePhase, Tone> = {
  disarmed: "plain",
  armed: "active",
  aligning: "active",
  throwing: "active",
  committed: "active",
  settling: "active",
  stopped: "alarm",
  fault: "alarm",
  lost: "look",
  never_seen: "look",
};

export const phaseWord = (phase: MachinePhase) => WORDS[phase];
export const phaseTone = (phase: MachinePhase) => TONES[phase];

/** "Disarmed", "Fault: boom sensor silent", "Lost since 14 s". */
export function lampWords(machine: Machine, nowMs: number): string {
  if (machine.lamp === "lost") {
    const since_s = ageSeconds(machine.link.last_seen_utc, nowMs);
    return since_s === null ? "Lost" : `Lost since ${age(since_s)}`;
  }
  if (machine.lamp === "fault" && machine.state?.fault) return `Fault: ${machine.state.fault}`;
  return WORDS[machine.lamp];
}

const MOVING: readonly MachinePhase[] = ["aligning", "throwing", "committed", "settling"];

export const isMoving = (phase: MachinePhase) => MOVING.includes(phase);

export type LinkQuality = { bars: 0 | 1 | 2 | 3; words: string };

/** Link of machine and server in three steps: round trip below 30 ms is good, above 150 ms poor. */
export function linkQuality(machine: Machine): LinkQuality {
  const { is_connected, round_trip_s, state_rate_hz } = machine.link;
  if (!is_connected) return { bars: 0, words: "no link" };
  const rate = state_rate_hz ?? 10;
  const trip = round_trip_s ?? 0;
  const words = round_trip_s === null ? "link up" : `${Math.round(round_trip_s * 1000)} ms`;
  if (rate < 4 || trip > 0.15) return { bars: 1, words };
  if (rate < 8 || trip > 0.03) return { bars: 2, words };
  return { bars: 3, words };
}
