import { Button, Popover } from "@mantine/core";
import { useState } from "react";
import { useMay } from "../../session/useSession";
import { errorWords } from "../../words/errors";
import { useFocusKept } from "../useFocusKept";
import { useGapActions, useTwinProfile } from "../useGap";
import { additionWords, type Diagnosis, type DiagnosisWords, doubtWords, type Run } from "../words";
import classes from "./ApplyPanel.module.css";
import { PreviewCompare } from "./PreviewCompare";

type Props = { run: Run; found: Diagnosis; words: DiagnosisWords };

/** Put what was found into the machine's twin, after a look at what that changes; and take it back. */
export function ApplyPanel({ run, found, words }: Props) {
  const twin = useTwinProfile(run.machine_id).data;
  const mayApply = useMay("twin.apply");
  const { apply, undo } = useGapActions(run.machine_id);
  const isApplied = run.applied_version_count !== null;
  // An undo of a later diagnosis brings this one back under a new number.
  const inUse = twin?.versions.find((version) => version.version_count === twin.version_count);
  const isInUse = isApplied && inUse?.gap_run_id === run.gap_run_id;
  const next = (twin?.version_count ?? run.profile_version_count) + 1;
  const doubt = doubtWords(found);
  const error = apply.error ?? undo.error;
  const kept = useFocusKept<HTMLDivElement>();
  return (
    <>
      <p className={classes.words}>
        {isApplied
          ? `Applied as version ${run.applied_version_count} of the twin of ${run.machine_id}${isInUse ? ", in use." : "; another version is in use now."}`
          : `${additionWords(words)} Previews of ${run.machine_id} then use it at once; undo brings the twin back.`}
      </p>
      {!isApplied && doubt && (
        <p className={classes.problem} role="note">
          {doubt}
        </p>
      )}
      {(!isApplied || isInUse) && (
        <PreviewCompare
          key={`${isInUse}`}
          machineId={run.machine_id}
          runId={run.gap_run_id}
          isInUse={isInUse}
        />
      )}
      <div className={classes.actions} {...kept}>
        {!isApplied && (
          <Confirm
            label="Apply to the twin"
            sentence={`Version ${next} of the twin of ${run.machine_id}. ${additionWords(words)}`}
            confirm={`Apply as version ${next}`}
            isDisabled={!mayApply}
            isPending={apply.isPending}
            onConfirm={() => apply.mutate(run.gap_run_id)}
          />
        )}
        {isInUse && twin?.undo_version_count !== null && (
          <Confirm
            label="Undo"
            sentence={`Back to what version ${twin?.undo_version_count} said, as version ${next}.`}
            confirm="Undo it"
            isDisabled={!mayApply}
            isPending={undo.isPending}
            onConfirm={() => undo.mutate()}
          />
        )}
        {!mayApply && <span className={classes.dim}>Engineers and admins may apply and undo.</span>}
      </div>
      {error && (
        <p className={classes.problem} role="alert">
          {errorWords(error)}
        </p>
      )}
    </>
  );
}

type ConfirmProps = {
  label: string;
  sentence: string;
  confirm: string;
  isDisabled: boolean;
  isPending: boolean;
  onConfirm: () => void;
};

/** A button that says what it will do before it does it. */
function Confirm(props: ConfirmProps) {
  const [isOpen, setOpen] = useState(false);
  const confirm = () => {
    setOpen(false);
    props.onConfirm();
  };
  return (
    <Popover opened={isOpen} onChange={setOpen} trapFocus width={340} position="top-start">
      <Popover.Target>
        <Button
          variant="default"
          disabled={props.isDisabled}
          loading={props.isPending}
          onClick={() => setOpen(!isOpen)}
        >
          {props.label}
        </Button>
      </Popover.Target>
      <Popover.Dropdown>
        <p className={classes.words}>{props.sentence}</p>
        <Button fullWidth data-autofocus onClick={confirm}>
          {props.confirm}
        </Button>
      </Popover.Dropdown>
    </Popover>
  );
}
