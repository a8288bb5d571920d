/** Words about what a machine has on board and what it is to have. */

import type { Approval, Deployment, Mode, OnBoard, PolicyState } from "./usePolicyLife";

const STATE_WORDS: Record<PolicyState, string> = {
  uploaded: "Uploaded",
  validating: "Validating",
  validated: "Validated",
  approved: "Approved",
  retired: "Retired",
};

export const stateWords = (state: PolicyState) => STATE_WORDS[state];

export type Place = "done" | "now" | "later";

/** The states of a life in their order; where the version is, and which it has been through. */
export function lifeSteps(
  state: PolicyState,
  history: readonly { to_state: PolicyState }[],
): { state: PolicyState; place: Place }[] {
  const middle: PolicyState = state === "validating" ? "validating" : "validated";
  const order: PolicyState[] = ["uploaded", middle, "approved"];
  if (state === "retired") order.push("retired");
  const seen = new Set(history.map((row) => row.to_state));
  return order.map((one) => ({
    state: one,
    place: one === state ? "now" : seen.has(one) ? "done" : "later",
  }));
}

type Named = { policy_id: string | null; policy_sha256: string | null };

/** "m545-2d-v7", the start of its hash where the server has no name, or that there is none. */
export const nameOf = (one: Named) =>
  one.policy_id ?? one.policy_sha256?.slice(0, 12) ?? "no usable version";

type Running = { machine_id: string; state: { policy_sha256?: Record<string, string> } | null };

/** Id of the row that shows what a machine has on board in a mode. */
export const onBoardRowId = (machineId: string, mode: Mode) => `on-board-${machineId}-${mode}`;

/** Machines whose newest state says that they throw with a version, by id. */
export const runningOn = (
  machines: Readonly<Record<string, Running>>,
  version: { mode: Mode; policy_sha256: string },
) =>
  Object.values(machines)
    .filter((one) => one.state?.policy_sha256?.[version.mode] === version.policy_sha256)
    .map((one) => one.machine_id)
    .sort();

/** The deployment that a machine has yet to carry out in a mode. */
export const pendingOf = (deployments: readonly Deployment[], mode: Mode) =>
  deployments.find((one) => one.mode === mode && one.outcome === "pending") ?? null;

/** What a machine is to do, and what it waits for. */
export function pendingWords(one: Deployment, lamp: string | null): string {
  const way = one.is_rollback ? "Goes back to" : "Switches to";
  const isAway = lamp === "lost" || lamp === "never_seen";
  const when = isAway
    ? `once ${one.machine_id} is connected again and no plan is armed`
    : "while no plan is armed";
  return [`${way} ${nameOf(one)} ${when}.`, one.detail].join(" ").trim();
}

/** "Switched", "Refused: ..." */
export function outcomeWords(one: Deployment): string {
  switch (one.outcome) {
    case "pending":
      return one.detail || "Waits for the machine";
    case "switched":
      return "Switched";
    case "refused":
      return one.detail ? `Refused: ${one.detail}` : "Refused";
    default:
      return "A newer deployment came first";
  }
}

export const approvalOf = (approvals: readonly Approval[], sha256: string) =>
  approvals.find((one) => one.policy_sha256 === sha256) ?? null;

/** Why a version cannot be deployed now; null where it can. */
export function deployRefusal(
  sha256: string,
  mode: Mode,
  facts: {
    problem: string | null;
    isApproved: boolean;
    isRetired: boolean;
    onBoard: readonly OnBoard[];
    deployments: readonly Deployment[];
    mayDeploy: boolean;
  },
): string | null {
  const { problem, isApproved, isRetired, onBoard, deployments, mayDeploy } = facts;
  if (isRetired) return "Retired: nothing is done with it any more.";
  if (problem) return "Its files cannot be used.";
  if (!isApproved) return "Not approved: machines would not load it.";
  const pending = pendingOf(deployments, mode);
  if (pending?.policy_sha256 === sha256) return "On its way already.";
  const own = onBoard.find((one) => one.mode === mode);
  if (pending === null && own?.policy_sha256 === sha256) return "On board.";
  if (!mayDeploy) return "Your role may look, not deploy. Ask an engineer.";
  return null;
}
