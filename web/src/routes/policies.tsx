import { ComparePanel } from "../compare/ComparePanel";
import { ShadowPanel } from "../compare/ShadowPanel";
import { useMachine } from "../machine/useMachine";
import { GateSentence } from "../operate/GateSentence";
import { KeysPanel } from "../policies/KeysPanel";
import { OnBoard } from "../policies/OnBoard";
import { PolicyCard } from "../policies/PolicyCard";
import { RolloutPanel } from "../policies/RolloutPanel";
import { UploadPanel } from "../policies/UploadPanel";
import { usePolicies } from "../throws/useThrows";
import { GatesPanel } from "../validation/GatesPanel";
import { errorWords } from "../words/errors";
import classes from "./policies.module.css";

/** Policies: the versions this server knows, what the chosen machine has on board, and what it is to have. */
export function PoliciesPage() {
  const policies = usePolicies();
  const machine = useMachine();
  const onBoard = machine?.state?.policy_sha256 ?? {};
  if (policies.isError) return <GateSentence sentence={errorWords(policies.error)} />;
  const all = policies.data ?? [];
  const rank = (isActive: boolean) => (isActive ? 0 : 1);
  const sorted = [...all].sort(
    (a, b) =>
      rank(a.is_active) - rank(b.is_active) ||
      a.mode.localeCompare(b.mode) ||
      b.first_seen_utc.localeCompare(a.first_seen_utc),
  );
  return (
    <div className={classes.page}>
      <h1>Policies</h1>
      <UploadPanel />
      {policies.data && all.length === 0 && (
        <GateSentence sentence="No policy version is known yet." />
      )}
      {machine && <OnBoard machineId={machine.machine_id} />}
      <RolloutPanel policies={sorted} />
      <ComparePanel policies={sorted} />
      <ShadowPanel policies={sorted} />
      <div className={classes.cards}>
        {sorted.map((policy) => (
          <PolicyCard
            key={policy.policy_sha256}
            policy={policy}
            machineId={machine?.machine_id ?? null}
            isOnBoard={onBoard[policy.mode] === policy.policy_sha256}
          />
        ))}
      </div>
      <div className={classes.gates}>
        <GatesPanel />
      </div>
      <KeysPanel />
    </div>
  );
}
