/**
 * What stands between the operator and a throw, most urgent first: one sentence and one next action
 * for each state. `null` means: nothing, hold to throw.
 * It only spares useless attempts: server and machine check all of it again. It is not the safety gate.
 */

import { isOwnName } from "../machine/leaseWords";
import { isMoving } from "../machine/phase";
import type { Schema } from "../session/client";
import type { Machine, Plan } from "../session/live";
import type { Permission } from "../session/useSession";
import { age, metres } from "../words/format";
import type { Target } from "./target/target";

export type GateAction =
  | "take_control"
  | "load"
  | "clear_stop"
  | "disarm"
  | "preview_again"
  | "other_mode"
  | "open_policies"
  | "use_surface"
  | null;

export type Gate = {
  id: string;
  sentence: string;
  action: GateAction;
  isAlarm?: boolean;
  /** Height that puts the target on a surface: what `use_surface` sets. */
  surface_m?: number;
};

export type GateFacts = {
  stale_s: number | null;
  isLoaded: boolean;
  machine: Machine | null;
  isHolder: boolean;
  permissions: readonly Permission[];
  username: string;
  mode: "2d" | "3d";
  target: Target | null;
  plan: Plan | null;
  planError: string | null;
};

/** A failed check with its remedy, as one sentence. */
export const checkSentence = ({ text, remedy }: Schema["CheckResult"]) =>
  `${text} ${remedy}`.trim();

type Rule = (facts: GateFacts) => Gate | null;

export function operateGate(facts: GateFacts): Gate | null {
  for (const rule of [
    connection,
    presence,
    stop,
    control,
    policy,
    motion,
    aim,
    refused,
    load,
    preview,
    checks,
  ]) {
    const gate = rule(facts);
    if (gate) return gate;
  }
  return null;
}

const connection: Rule = ({ stale_s, isLoaded }) => {
  if (!isLoaded) return { id: "connecting", sentence: "Connecting to the server.", action: null };
  if (stale_s === null) return null;
  const sentence = `Not live: last data ${age(stale_s)} ago. Throwing is blocked until the link is back.`;
  return { id: "offline", sentence, action: null };
};

const presence: Rule = ({ machine }) => {
  if (!machine) {
    const sentence = "No machine has connected to this server yet. Start one: downrange machine.";
    return { id: "empty", sentence, action: null };
  }
  const name = machine.machine_id;
  if (machine.lamp === "never_seen")
    return { id: "never_seen", sentence: `${name} has never connected. Start it.`, action: null };
  if (machine.lamp === "lost")
    return {
      id: "lost",
      sentence: `${name} is lost. It holds by itself; control returns with the link.`,
      action: null,
    };
  if (machine.unknown_throw_id) {
    const sentence = `${name} has not said whether it started. Blocked until it reports; nothing is sent twice.`;
    return { id: "unknown", sentence, action: null };
  }
  return null;
};

const stop: Rule = ({ machine, isHolder, permissions }) => {
  const isStopped = machine?.lamp === "stopped" || machine?.state?.stop_latched;
  if (!machine || (!isStopped && machine.lamp !== "fault")) return null;
  const what = isStopped
    ? `STOP is latched on ${machine.machine_id}.`
    : `Fault: ${machine.state?.fault || "the machine gives no detail"}.`;
  const id = isStopped ? "stopped" : "fault";
  if (!permissions.includes("stop.clear"))
    return { id, sentence: `${what} A supervisor clears it.`, action: null, isAlarm: true };
  if (!isHolder)
    return {
      id,
      sentence: `${what} Take control to clear it.`,
      action: "take_control",
      isAlarm: true,
    };
  return { id, sentence: what, action: "clear_stop", isAlarm: true };
};

const control: Rule = ({ machine, isHolder, permissions, username }) => {
  if (!machine || isHolder) return null;
  const { holder } = machine.lease;
  if (!permissions.includes("throw")) {
    const sentence = "You may watch. Throwing needs the operator role.";
    return { id: "may_not", sentence, action: null };
  }
  if (holder) {
    const sentence = isOwnName(machine.lease, username)
      ? `You are in control of ${machine.machine_id} in another browser. Give control back there first.`
      : `${holder} is in control of ${machine.machine_id}. You watch until control is given back.`;
    return { id: "held_by_another", sentence, action: null };
  }
  const sentence = `Nobody is in control of ${machine.machine_id}.`;
  return { id: "no_lease", sentence, action: "take_control" };
};

const policy: Rule = ({ machine, mode }) => {
  const modes = machine?.reach.modes ?? [];
  const label = mode.toUpperCase();
  const active = modes.find((other) => other.mode === mode);
  if (!active) {
    const other = modes[0];
    if (!other)
      return { id: "no_policy", sentence: "No policy is active.", action: "open_policies" };
    const sentence = `No ${label} policy is active. ${other.mode.toUpperCase()} is.`;
    return { id: "no_policy", sentence, action: "other_mode" };
  }
  const onBoard = machine?.state?.policy_sha256?.[mode];
  if (machine?.state && onBoard !== active.policy_sha256) {
    const here = `${active.policy_id} (${active.policy_sha256.slice(0, 12)})`;
    const sentence = onBoard
      ? `${machine.machine_id} has ${label} policy ${onBoard.slice(0, 12)} on board, which the server lacks; the server previews with ${here}. Upload the first or deploy the second.`
      : `${machine.machine_id} has no ${label} policy on board. Deploy ${here}.`;
    return { id: "wrong_policy", sentence, action: "open_policies" };
  }
  return null;
};

const aim: Rule = ({ target }) =>
  target
    ? null
    : { id: "no_target", sentence: "No target. Click the ground, or type a range.", action: null };

const motion: Rule = ({ machine }) => {
  if (machine && isMoving(machine.lamp)) {
    const sentence = `${machine.machine_id} is moving. Wait until it has settled.`;
    return { id: "moving", sentence, action: null };
  }
  if (machine?.lamp === "armed") {
    const sentence = `${machine.machine_id} is armed. Disarm it before the next throw.`;
    return { id: "armed", sentence, action: "disarm" };
  }
  return null;
};

const load: Rule = ({ machine }) =>
  !machine?.state || machine.state.payload_held
    ? null
    : { id: "no_payload", sentence: "The gripper is empty.", action: "load" };

/** A target that cannot be hit is said first: no load makes it better. */
const refused: Rule = ({ plan, planError, target }) => {
  if (planError) return { id: "plan_error", sentence: planError, action: "preview_again" };
  if (plan?.state === "failed")
    return { id: "failed", sentence: "The preview failed.", action: "preview_again" };
  if (plan?.state !== "refused") return null;
  const refusal = plan.refusals[0];
  const sentence = refusal?.detail ?? `Refused: target ${metres(target?.range_m)}.`;
  const surface_m = refusal?.surface_m ?? null;
  if (surface_m === null) return { id: "refused", sentence, action: null };
  return { id: "refused", sentence, action: "use_surface", surface_m };
};

const preview: Rule = ({ plan }) => {
  if (!plan?.prediction) return { id: "previewing", sentence: "Computing the throw", action: null };
  if (!plan.is_complete)
    return { id: "previewing", sentence: "Computing the spread", action: null };
  return null;
};

const checks: Rule = ({ machine }) => {
  const failed = machine?.state?.checks?.find((c) => !c.passed && c.severity === "error");
  if (!failed) return null;
  return { id: "check", sentence: checkSentence(failed), action: null };
};
