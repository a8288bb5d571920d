/** What the server tells by itself, kept in one place: a pure reducer over events and a tiny store. */

import { replaceEqualDeep } from "@tanstack/react-query";
import type { Schema } from "./client";
import { quiet } from "./quiet";

export type Machine = Schema["MachineView"];
export type Plan = Schema["PlanView"];
export type Throw = Schema["ThrowRow"];
export type GapRun = Schema["GapRunRow"];
export type Alert = Schema["AlertEvent"] & { id: number };
export type ServerEvent =
  | Schema["MachineStateEvent"]
  | Schema["MachineLostEvent"]
  | Schema["MachineRetiredEvent"]
  | Schema["LeaseChangedEvent"]
  | Schema["TargetProposedEvent"]
  | Schema["PointPickedEvent"]
  | Schema["PlanUpdatedEvent"]
  | Schema["ThrowUpdatedEvent"]
  | Schema["GapUpdatedEvent"]
  | Schema["TwinUpdatedEvent"]
  | Schema["SiteUpdatedEvent"]
  | Schema["ZonesUpdatedEvent"]
  | Schema["AlertEvent"]
  | Schema["AlertUpdatedEvent"]
  | Schema["RolloutUpdatedEvent"]
  | Schema["JobUpdatedEvent"];

export type Live = {
  machines: Readonly<Record<string, Machine>>;
  plans: Readonly<Record<string, Plan>>;
  throws: Readonly<Record<string, Throw>>;
  gapRuns: Readonly<Record<string, GapRun>>;
  /** What stands around machines, as far as it was changed since the page was opened. */
  sites: Readonly<Record<string, Schema["SiteView"]>>;
  /** Exclusion zones, as far as they were changed since the page was opened. */
  zones: Readonly<Record<string, Schema["ZonesView"]>>;
  /** Why a picked point cannot be a target, by machine. */
  targetRefusals: Readonly<Record<string, string>>;
  /** The last point clicked in the 3D view for something else than the target, by machine. */
  picked: Readonly<Record<string, Schema["PointPickedEvent"]>>;
  /** Machines whose target this page is telling the server: until then an echo is of an older one. */
  proposing: Readonly<Record<string, boolean>>;
  /** Last lease change by machine, to tell why control was lost. */
  leaseNews: Readonly<Record<string, Schema["LeaseChangedEvent"]>>;
  /** News that lies over the page until dismissed. */
  alerts: readonly Alert[];
  /** What is wrong now, by the alert's id. */
  openAlerts: Readonly<Record<string, Schema["AlertView"]>>;
  isLoaded: boolean;
  /** How often everything was read anew, because events may have been missed. */
  resync_count: number;
};

export type LiveAction =
  | { kind: "resync"; machines: readonly Machine[] }
  | { kind: "alerts"; alerts: readonly Schema["AlertView"][] }
  | { kind: "event"; event: ServerEvent; sessionId: string | null }
  | { kind: "plan"; plan: Plan }
  | { kind: "target"; machineId: string; target: Schema["TargetView"] | null; isProposing: boolean }
  | { kind: "target_sent"; machineId: string }
  | { kind: "dismiss"; id: number };

export const EMPTY_LIVE: Live = {
  machines: {},
  plans: {},
  throws: {},
  gapRuns: {},
  sites: {},
  zones: {},
  targetRefusals: {},
  picked: {},
  proposing: {},
  leaseNews: {},
  alerts: [],
  openAlerts: {},
  isLoaded: false,
  resync_count: 0,
};

const ALERT_LIMIT = 20;
const KEPT_LIMIT = 50;

/** Put an entry in and forget the oldest beyond the limit, so that days of events stay small. */
function put<T>(record: Readonly<Record<string, T>>, key: string, value: T): Record<string, T> {
  const rest = Object.entries(record).filter(([other]) => other !== key);
  return Object.fromEntries([...rest.slice(-(KEPT_LIMIT - 1)), [key, value]]);
}

function putPlan(live: Live, plan: Plan): Live {
  return { ...live, plans: put(live.plans, plan.plan_id, plan) };
}

function patch(live: Live, id: string, change: (machine: Machine) => Machine): Live {
  const machine = live.machines[id];
  if (!machine) return live;
  return { ...live, machines: { ...live.machines, [id]: change(machine) } };
}

export function reduceLive(live: Live, action: LiveAction): Live {
  switch (action.kind) {
    case "resync":
      return {
        ...live,
        isLoaded: true,
        resync_count: live.resync_count + 1,
        // News of runs may have been missed: what is asked anew counts.
        gapRuns: {},
        machines: Object.fromEntries(action.machines.map((m) => [m.machine_id, quiet(m)])),
      };
    case "alerts":
      return {
        ...live,
        openAlerts: Object.fromEntries(action.alerts.map((alert) => [alert.alert_id, alert])),
      };
    case "plan":
      // The answer to a request may arrive after newer news of the same plan.
      return action.plan.plan_id in live.plans ? live : putPlan(live, action.plan);
    case "target":
      return patch(
        {
          ...live,
          targetRefusals: { ...live.targetRefusals, [action.machineId]: "" },
          proposing: { ...live.proposing, [action.machineId]: action.isProposing },
        },
        action.machineId,
        (machine) => ({ ...machine, target: action.target }),
      );
    case "target_sent":
      return { ...live, proposing: { ...live.proposing, [action.machineId]: false } };
    case "dismiss":
      return { ...live, alerts: live.alerts.filter((alert) => alert.id !== action.id) };
    case "event":
      return onEvent(live, action.event, action.sessionId);
  }
}

function onEvent(live: Live, event: ServerEvent, sessionId: string | null): Live {
  switch (event.kind) {
    case "machine.state":
      return onMachine(live, event.machine);
    case "machine.lost":
      return patch(live, event.machine_id, (machine) => ({
        ...machine,
        lamp: "lost",
        lamp_text: "lost",
        link: { ...machine.link, is_connected: false, last_seen_utc: event.last_seen_utc },
      }));
    case "machine.retired": {
      const { [event.machine_id]: _retired, ...machines } = live.machines;
      return { ...live, machines };
    }
    case "lease.changed":
      return patch(
        { ...live, leaseNews: { ...live.leaseNews, [event.lease.machine_id]: event } },
        event.lease.machine_id,
        (machine) => ({ ...machine, lease: event.lease }),
      );
    case "target.proposed":
      return event.session_id === sessionId ? onTarget(live, event) : live;
    case "point.picked":
      if (event.session_id !== sessionId) return live;
      return { ...live, picked: { ...live.picked, [event.machine_id]: event } };
    case "plan.updated":
      return putPlan(live, event.plan);
    case "throw.updated":
      return { ...live, throws: put(live.throws, event.throw.throw_id, event.throw) };
    case "gap.updated":
      return { ...live, gapRuns: put(live.gapRuns, event.run.gap_run_id, event.run) };
    case "twin.updated":
    case "rollout.updated":
    case "job.updated":
      return live;
    case "site.updated":
      return { ...live, sites: { ...live.sites, [event.site.machine_id]: event.site } };
    case "zones.updated":
      return { ...live, zones: { ...live.zones, [event.zones.machine_id]: event.zones } };
    case "alert":
      return { ...live, alerts: addAlert(live.alerts, event) };
    case "alert.updated":
      return onAlert(live, event.alert);
  }
}

/**
 * Broadcasts carry no target: it belongs to one session, so ours is kept. What did not change keeps its
 * identity: ten states a second must not draw the page ten times a second.
 */
function onMachine(live: Live, machine: Machine): Live {
  const known = live.machines[machine.machine_id];
  const target = machine.target ?? known?.target ?? null;
  const next = replaceEqualDeep(known, { ...quiet(machine), target });
  if (next === known) return live;
  return { ...live, machines: { ...live.machines, [machine.machine_id]: next } };
}

function onTarget(live: Live, event: Schema["TargetProposedEvent"]): Live {
  const refusals = { ...live.targetRefusals, [event.machine_id]: event.refusal };
  const isEcho = event.source === "fields" && live.proposing[event.machine_id];
  if (isEcho || (event.refusal && !event.target)) return { ...live, targetRefusals: refusals };
  return patch({ ...live, targetRefusals: refusals }, event.machine_id, (machine) => ({
    ...machine,
    target: event.target,
  }));
}

function onAlert(live: Live, alert: Schema["AlertView"]): Live {
  if (alert.cleared_utc === null) {
    return { ...live, openAlerts: { ...live.openAlerts, [alert.alert_id]: alert } };
  }
  const { [alert.alert_id]: _, ...openAlerts } = live.openAlerts;
  return { ...live, openAlerts };
}

function addAlert(alerts: readonly Alert[], event: Schema["AlertEvent"]): readonly Alert[] {
  const id = (alerts.at(-1)?.id ?? 0) + 1;
  const others = alerts.filter((a) => a.code !== event.code || a.machine_id !== event.machine_id);
  return [...others, { ...event, id }].slice(-ALERT_LIMIT);
}
