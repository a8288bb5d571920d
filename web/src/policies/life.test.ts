import { describe, expect, it } from "vitest";
import {
  deployRefusal,
  lifeSteps,
  nameOf,
  outcomeWords,
  pendingOf,
  pendingWords,
  runningOn,
} from "./life";
import type { Deployment, OnBoard } from "./usePolicyLife";

const A = "a".repeat(64);
const B = "b".repeat(64);

const deployment = (more: Partial<Deployment>): Deployment => ({
  machine_id: "m001",
  mode: "2d",
  deployment_count: 1,
  policy_sha256: A,
  policy_id: "m545-2d-v6",
  is_rollback: false,
  reason: "less spread",
  created_by: "ada",
  created_utc: "2026-11-27T10:00:00Z",
  outcome: "pending",
  detail: "",
  ended_utc: null,
  ...more,
});

const onBoard = (sha256: string): OnBoard[] => [
  {
    mode: "2d",
    policy_sha256: sha256,
    policy_id: null,
    since_utc: "2026-11-27T09:00:00Z",
    version_before: null,
    rolled_back_from: null,
  },
];

const facts = {
  problem: null,
  isApproved: true,
  isRetired: false,
  onBoard: onBoard(B),
  deployments: [],
  mayDeploy: true,
};

describe("a version's life on a machine", () => {
  it("says why a version cannot be deployed", () => {
    expect(deployRefusal(A, "2d", facts)).toBeNull();
    expect(deployRefusal(B, "2d", facts)).toBe("On board.");
    expect(deployRefusal(A, "2d", { ...facts, problem: "hash" })).toContain("cannot be used");
    expect(deployRefusal(A, "2d", { ...facts, isApproved: false })).toContain("Not approved");
    expect(deployRefusal(A, "2d", { ...facts, mayDeploy: false })).toContain("Your role");
    const pending = [deployment({})];
    expect(deployRefusal(A, "2d", { ...facts, deployments: pending })).toContain("On its way");
  });

  it("lets a person go back to what is on board while another version is on its way", () => {
    expect(deployRefusal(B, "2d", { ...facts, deployments: [deployment({})] })).toBeNull();
  });

  it("says what a machine waits for before it switches", () => {
    const detail = "It fetches the version.";
    expect(pendingWords(deployment({}), "armed")).toBe(
      "Switches to m545-2d-v6 while no plan is armed.",
    );
    expect(pendingWords(deployment({ is_rollback: true, detail }), "lost")).toBe(
      "Goes back to m545-2d-v6 once m001 is connected again and no plan is armed. It fetches the version.",
    );
  });

  it("names the machines that throw with a version", () => {
    const machine = (machine_id: string, sha256: string | null) => ({
      machine_id,
      state: sha256 === null ? null : { policy_sha256: { "2d": sha256 } },
    });
    const all = [machine("m003", A), machine("m002", B), machine("m004", null), machine("m001", A)];
    const machines = Object.fromEntries(all.map((one) => [one.machine_id, one]));
    expect(runningOn(machines, { mode: "2d", policy_sha256: A })).toEqual(["m001", "m003"]);
    expect(runningOn(machines, { mode: "3d", policy_sha256: A })).toEqual([]);
  });

  it("finds what a machine has yet to do in a mode", () => {
    const all = [deployment({ mode: "3d" }), deployment({ outcome: "switched" })];
    expect(pendingOf(all, "3d")?.mode).toBe("3d");
    expect(pendingOf(all, "2d")).toBeNull();
  });

  it("says what became of a deployment", () => {
    expect(outcomeWords(deployment({}))).toBe("Waits for the machine");
    expect(outcomeWords(deployment({ outcome: "refused", detail: "not approved" }))).toBe(
      "Refused: not approved",
    );
    expect(outcomeWords(deployment({ outcome: "replaced" }))).toContain("newer");
  });

  it("names a version whose files are gone by its hash", () => {
    expect(nameOf({ policy_id: null, policy_sha256: A })).toBe("aaaaaaaaaaaa");
    expect(nameOf({ policy_id: null, policy_sha256: null })).toBe("no usable version");
  });
});

describe("the life of a version", () => {
  const places = (...args: Parameters<typeof lifeSteps>) =>
    lifeSteps(...args).map(({ state, place }) => `${state} ${place}`);

  it("calls done only what the history holds", () => {
    const skipped = [{ to_state: "uploaded" as const }, { to_state: "approved" as const }];
    expect(places("approved", skipped)).toEqual([
      "uploaded done",
      "validated later",
      "approved now",
    ]);
    const whole = [...skipped, { to_state: "validated" as const }];
    expect(places("retired", whole).at(1)).toBe("validated done");
    expect(places("retired", whole).at(-1)).toBe("retired now");
  });

  it("shows that a validation runs", () => {
    expect(places("validating", [{ to_state: "uploaded" }])[1]).toBe("validating now");
  });

  it("deploys nothing that is retired", () => {
    expect(deployRefusal(A, "2d", { ...facts, isRetired: true })).toMatch(/^Retired/);
  });
});
