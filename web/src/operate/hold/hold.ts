/**
 * The hold button as a pure state machine: `reduce(state, event) -> [state, actions]`.
 *
 * Letting go always wins: whatever is on its way is followed by its undoing. After the commit point
 * letting go changes nothing on the machine, and the state says so.
 * `release` here is that of the button; the load's is a matter of the machine.
 */

import type { MachinePhase } from "../../machine/phase";

export const ARM_RING_MS = 1000;
export const HEARTBEAT_MS = 50;

export type ReleaseCause = "released" | "blur" | "hidden" | "cancelled" | "disabled" | "link";

export type Hold =
  | { phase: "idle"; note: string | null }
  | { phase: "ring" }
  | { phase: "arm_sent" }
  | { phase: "fire_sent" }
  | { phase: "holding"; throwId: string }
  | { phase: "committed"; throwId: string; isPressed: boolean }
  | { phase: "letting_go"; throwId: string | null; cause: ReleaseCause; wasFired: boolean };

export type HoldEvent =
  | { kind: "press" }
  | { kind: "release"; cause: ReleaseCause }
  | { kind: "ring_full" }
  | { kind: "armed" }
  | { kind: "fired"; throwId: string }
  | { kind: "failed"; text: string }
  | { kind: "link_lost" }
  | { kind: "machine"; phase: MachinePhase; throwId: string | null }
  | { kind: "ended"; throwId: string };

export type Action =
  | "start_ring"
  | "stop_ring"
  | "arm"
  | "disarm"
  | "fire"
  | "abort"
  | "beat"
  | "rest";

export const IDLE: Hold = { phase: "idle", note: null };

const CAUSE_WORDS: Record<ReleaseCause, string> = {
  released: "Let go before the commit point: the throw was aborted.",
  blur: "The button lost focus: the throw was aborted.",
  hidden: "The page was hidden: the throw was aborted.",
  cancelled: "The touch was interrupted: the throw was aborted.",
  disabled: "Control was lost: the throw was aborted.",
  link: "The link for the hold signal broke: nothing was thrown.",
};

type Step = [Hold, Action[]];

export function reduce(state: Hold, event: HoldEvent): Step {
  switch (event.kind) {
    case "press":
      return state.phase === "idle" ? [{ phase: "ring" }, ["start_ring"]] : [state, []];
    case "release":
      return letGo(state, event.cause);
    case "ring_full":
      return state.phase === "ring" ? [{ phase: "arm_sent" }, ["arm"]] : [state, []];
    case "armed":
      return onArmed(state);
    case "fired":
      return onFired(state, event.throwId);
    case "failed":
      return onFailed(state, event.text);
    case "link_lost":
      return onLinkLost(state);
    case "machine":
      return onMachine(state, event.phase, event.throwId);
    case "ended":
      return onEnded(state, event.throwId);
  }
}

function idle(note: string | null, actions: Action[]): Step {
  return [{ phase: "idle", note }, actions];
}

function letGo(state: Hold, cause: ReleaseCause): Step {
  switch (state.phase) {
    case "ring":
      return idle("Hold for one second to arm, then keep holding.", ["stop_ring"]);
    case "arm_sent":
      return [{ phase: "letting_go", throwId: null, cause, wasFired: false }, []];
    case "fire_sent":
      return [{ phase: "letting_go", throwId: null, cause, wasFired: true }, ["abort"]];
    case "holding":
      return [
        { phase: "letting_go", throwId: state.throwId, cause, wasFired: true },
        ["rest", "abort"],
      ];
    case "committed":
      return [{ ...state, isPressed: false }, ["rest"]];
    default:
      return [state, []];
  }
}

function onArmed(state: Hold): Step {
  if (state.phase === "arm_sent") return [{ phase: "fire_sent" }, ["fire"]];
  if (state.phase === "letting_go" && !state.wasFired)
    return idle(CAUSE_WORDS[state.cause], ["disarm"]);
  return [state, []];
}

function onFired(state: Hold, throwId: string): Step {
  if (state.phase === "fire_sent") return [{ phase: "holding", throwId }, ["beat"]];
  // Let go while the order was under way: say it again now that the throw has a name.
  if (state.phase === "letting_go") return [{ ...state, throwId }, ["rest", "abort"]];
  return [state, []];
}

function onFailed(state: Hold, text: string): Step {
  switch (state.phase) {
    case "arm_sent":
      return idle(text, []);
    case "fire_sent":
      return idle(text, ["rest", "abort"]);
    case "letting_go":
      return idle(`${CAUSE_WORDS[state.cause]} ${text}`, ["rest"]);
    default:
      return [state, []];
  }
}

function onLinkLost(state: Hold): Step {
  if (state.phase === "ring") return idle(CAUSE_WORDS.link, ["stop_ring"]);
  if (state.phase === "arm_sent") return letGo(state, "link");
  if (state.phase === "holding" || state.phase === "fire_sent")
    return idle("The hold signal was lost: before the release the machine aborts by itself.", [
      "rest",
      "abort",
    ]);
  return [state, []];
}

function onMachine(state: Hold, phase: MachinePhase, throwId: string | null): Step {
  if (state.phase === "idle" || state.phase === "ring" || state.phase === "arm_sent")
    return [state, []];
  const isOurs = "throwId" in state && state.throwId !== null && state.throwId === throwId;
  if (
    (state.phase === "holding" || state.phase === "letting_go") &&
    phase === "committed" &&
    isOurs
  )
    return [
      { phase: "committed", throwId: throwId as string, isPressed: state.phase === "holding" },
      [],
    ];
  return onMachineEnd(state, phase, isOurs);
}

/** The machine has left the throw: settled, disarmed, stopped or faulted. */
function onMachineEnd(state: Hold, phase: MachinePhase, isOurs: boolean): Step {
  if (phase === "stopped") return idle("STOP is latched.", ["rest"]);
  if (phase === "fault") return idle("The machine reports a fault.", ["rest"]);
  const isOver = phase === "settling" || phase === "disarmed";
  if (!isOver) return [state, []];
  if (state.phase === "committed") return idle(null, ["rest"]);
  if (state.phase === "letting_go") return idle(CAUSE_WORDS[state.cause], ["rest"]);
  if (state.phase === "holding" && isOurs && phase === "settling") return idle(null, ["rest"]);
  return [state, []];
}

/** The throw is over, however it ended; the result says how. */
function onEnded(state: Hold, throwId: string): Step {
  const isOurs = "throwId" in state && state.throwId === throwId;
  if (!isOurs) return [state, []];
  return idle(state.phase === "letting_go" ? CAUSE_WORDS[state.cause] : null, ["rest"]);
}

/** True while letting go would still abort. */
export function isAbortable(state: Hold): boolean {
  return ["ring", "arm_sent", "fire_sent", "holding"].includes(state.phase);
}

/** The words on the button. */
export function buttonWords(state: Hold): string {
  switch (state.phase) {
    case "idle":
      return "Hold to throw";
    case "ring":
      return "Keep holding to arm";
    case "arm_sent":
      return "Arming";
    case "fire_sent":
      return "Starting";
    case "holding":
      return "Throwing: keep holding";
    case "committed":
      return "Committed: letting go no longer stops it";
    case "letting_go":
      return "Letting go";
  }
}
