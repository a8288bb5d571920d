/** Which alerts call for a look, and how alerts are said. */

import type { Schema } from "../session/client";
import { count } from "../words/format";

export type Alert = Schema["AlertView"];
export type Rule = Schema["AlertRule"];
export type Tone = "alarm" | "look";

export const RULE_WORDS: Record<Rule, string> = {
  lost: "Machine lost",
  stopped: "Stopped",
  fault: "Fault",
  arm_refused: "Refused to arm",
  records: "Records not delivered",
  clock: "Clock",
  disk: "Disk",
  certificate: "Certificate",
  expired: "Certificate expired",
  drift: "Drift",
  rollout: "Rollout paused",
};

export const RULES = Object.keys(RULE_WORDS) as Rule[];

/** Red is for STOP and faults alone. */
export const toneOf = (rule: Rule): Tone =>
  rule === "stopped" || rule === "fault" ? "alarm" : "look";

export function isSilent(alert: Alert, nowMs: number): boolean {
  return alert.silenced_until_utc !== null && Date.parse(alert.silenced_until_utc) > nowMs;
}

/** Open, seen by nobody yet, and not silenced. */
export function needsLook(alert: Alert, nowMs: number): boolean {
  return alert.cleared_utc === null && alert.acknowledged_by === null && !isSilent(alert, nowMs);
}

export type Attention = { alert_count: number; tone: Tone; words: string };

/** What the badge shows; null when nothing calls for a look. */
export function attention(alerts: readonly Alert[], nowMs: number): Attention | null {
  const calling = alerts.filter((alert) => needsLook(alert, nowMs));
  if (calling.length === 0) return null;
  const isAlarm = calling.some((alert) => toneOf(alert.rule) === "alarm");
  return {
    alert_count: calling.length,
    tone: isAlarm ? "alarm" : "look",
    words: `${count(calling.length, "alert")} ${calling.length === 1 ? "needs" : "need"} a look`,
  };
}

/** Those that call for a look first, then the newest. */
export function inOrder(alerts: readonly Alert[], nowMs: number): Alert[] {
  const rank = (alert: Alert) => (needsLook(alert, nowMs) ? 0 : 1);
  return [...alerts].sort((a, b) => rank(a) - rank(b) || b.alert_id.localeCompare(a.alert_id));
}

export type AlertSearch = { state?: "cleared" | "webhooks"; machine?: string; rule?: Rule };

const text = (value: unknown) => (typeof value === "string" && value !== "" ? value : undefined);

/** Search part of the address to filters; anything unreadable is left out. */
export function parseAlertSearch(search: Record<string, unknown>): AlertSearch {
  const machine = text(search.machine);
  const rule = RULES.find((known) => known === search.rule);
  return {
    ...((search.state === "cleared" || search.state === "webhooks") && { state: search.state }),
    ...(machine && { machine }),
    ...(rule && { rule }),
  };
}

export function matches(alert: Alert, search: AlertSearch): boolean {
  return (
    (search.machine === undefined || alert.machine_id === search.machine) &&
    (search.rule === undefined || alert.rule === search.rule)
  );
}
