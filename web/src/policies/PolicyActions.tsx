import { Button } from "@mantine/core";
import { useState } from "react";
import type { Schema } from "../session/client";
import { useMay } from "../session/useSession";
import { zonedStamp } from "../words/time";
import { ApproveDialog } from "./ApproveDialog";
import { ConfirmDialog } from "./ConfirmDialog";
import { approvalOf, deployRefusal, onBoardRowId } from "./life";
import classes from "./PolicyCard.module.css";
import { useApprovals, useDeployments, useOnBoard, usePolicyActions } from "./usePolicyLife";

type Props = { policy: Schema["PolicyView"]; machineId: string };
type Asking = "deploy" | "approve" | "withdraw" | "retire" | null;

/** Who has approved a version, and what may be done with it on the machine that is chosen. */
export function PolicyActions({ policy, machineId }: Props) {
  const [asking, setAsking] = useState<Asking>(null);
  const approvals = useApprovals();
  const onBoard = useOnBoard(machineId, null);
  const deployments = useDeployments(machineId);
  const mayApprove = useMay("policy.approve");
  const mayDeploy = useMay("policy.deploy");
  const { deploy, approve, withdraw, retire } = usePolicyActions(machineId);
  if (!approvals.data || !onBoard.data || !deployments.data) return null;
  const { policy_sha256, policy_id, mode, state } = policy;
  const approval = approvalOf(approvals.data, policy_sha256);
  const why = deployRefusal(policy_sha256, mode, {
    problem: policy.problem,
    isApproved: approval !== null,
    isRetired: state === "retired",
    onBoard: onBoard.data.policies,
    deployments: deployments.data,
    mayDeploy,
  });
  const close = () => {
    setAsking(null);
    for (const one of [deploy, approve, withdraw, retire]) one.reset();
  };
  const done = { onSuccess: () => setAsking(null) };
  const shown = mode.toUpperCase();
  return (
    <div className={classes.actions}>
      <p className={classes.approval}>
        {approval
          ? `Approved by ${approval.approved_by}, ${zonedStamp(approval.approved_utc)}`
          : "Not approved"}
      </p>
      <div className={classes.buttons}>
        <Button
          size="md"
          disabled={why !== null}
          onClick={() => setAsking("deploy")}
          aria-label={`Deploy to ${machineId}: ${policy_id}`}
        >
          Deploy to {machineId}
        </Button>
        {mayApprove &&
          (approval ? (
            <Button variant="default" size="md" onClick={() => setAsking("withdraw")}>
              Withdraw approval
            </Button>
          ) : (
            <Button
              variant="default"
              size="md"
              disabled={!policy.is_present || state === "retired" || state === "validating"}
              onClick={() => setAsking("approve")}
            >
              Approve
            </Button>
          ))}
        {mayApprove && state !== "retired" && state !== "validating" && (
          <Button
            variant="default"
            size="md"
            aria-label={`Retire ${policy_id}`}
            onClick={() => setAsking("retire")}
          >
            Retire
          </Button>
        )}
        {why && <span className={classes.why}>{why}</span>}
      </div>
      {asking === "deploy" && (
        <ConfirmDialog
          title={`Deploy ${policy_id} to ${machineId}`}
          action="Deploy"
          isPending={deploy.isPending}
          error={deploy.error}
          resultId={onBoardRowId(machineId, mode)}
          onConfirm={(reason) => deploy.mutate({ mode, policy_sha256, reason }, done)}
          onClose={close}
        >
          <p>
            {machineId} fetches it, checks the site's signature, and throws in {shown} with it as
            soon as no plan is armed. The version before stays on board; rolling back takes one
            press.
          </p>
        </ConfirmDialog>
      )}
      {asking === "approve" && (
        <ApproveDialog
          policy={policy}
          isPending={approve.isPending}
          error={approve.error}
          onConfirm={(wish) => approve.mutate(wish, done)}
          onClose={close}
        />
      )}
      {asking === "withdraw" && (
        <ConfirmDialog
          title={`Withdraw the approval of ${policy_id}`}
          action="Withdraw"
          isPending={withdraw.isPending}
          error={withdraw.error}
          onConfirm={(reason) => withdraw.mutate({ sha256: policy_sha256, reason }, done)}
          onClose={close}
        >
          <p>
            Every machine of the site stops using it as soon as no plan is armed. A machine that has
            no other approved version in {shown} cannot throw in {shown}.
          </p>
        </ConfirmDialog>
      )}
      {asking === "retire" && (
        <ConfirmDialog
          title={`Retire ${policy_id}`}
          action={`Retire ${policy_id} for good`}
          isPending={retire.isPending}
          error={retire.error}
          onConfirm={(reason) => retire.mutate({ sha256: policy_sha256, reason }, done)}
          onClose={close}
        >
          <p>
            No machine can be given it any more, and that cannot be undone. Refused while a machine
            runs it or may go back to it. Its history and throws stay.
          </p>
        </ConfirmDialog>
      )}
    </div>
  );
}
