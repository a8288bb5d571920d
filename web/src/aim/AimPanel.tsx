import { Button, SegmentedControl } from "@mantine/core";
import { useState } from "react";
import classes from "../fleet/Fleet.module.css";
import { useMay } from "../session/useSession";
import { errorWords } from "../words/errors";
import { count, fixed, metres } from "../words/format";
import { zonedStamp } from "../words/time";
import { AimChart } from "./AimChart";
import { type AimMode, type AimVersion, type Proposal, useAim, useAimActions } from "./useAim";

type Mode = AimMode["mode"];

/** What a machine misses on average, the correction of it, and earlier ones. */
export function AimPanel({ machineId }: { machineId: string }) {
  const aim = useAim(machineId);
  const [mode, setMode] = useState<Mode>("2d");
  const shown = aim.data?.modes.find((one) => one.mode === mode);
  if (!aim.data || !shown) return null;
  const content = shown.proposal ?? shown.in_force?.content;
  return (
    <section aria-label="Aim correction">
      <div className={classes.head}>
        <h2>Aim correction</h2>
        <SegmentedControl
          aria-label="Mode of the aim correction"
          data={[
            { value: "2d", label: "2D" },
            { value: "3d", label: "3D" },
          ]}
          value={mode}
          onChange={(value) => setMode(value as Mode)}
        />
      </div>
      {content && (
        <div className={classes.panels}>
          {(["downrange", "crossrange"] as const).map((axis) => (
            <div key={axis} className={classes.chart}>
              <AimChart content={content} axis={axis} />
            </div>
          ))}
        </div>
      )}
      <Actions key={mode} machineId={machineId} shown={shown} />
      <History versions={aim.data.history.filter((one) => one.mode === mode)} />
    </section>
  );
}

function Actions({ machineId, shown }: { machineId: string; shown: AimMode }) {
  const mayApply = useMay("aim.apply");
  const { apply, undo } = useAimActions(machineId, shown.mode);
  const error = apply.error ?? undo.error;
  const { in_force, proposal, proposal_sha256 } = shown;
  return (
    <>
      <p>
        {in_force
          ? `Correction v${in_force.version_count} is in force, made from ${count(in_force.content.throw_count, "throw")}.`
          : "No correction is in force: the machine aims by its registration alone."}{" "}
        {proposal ? gainWords(proposal) : shown.problem}
      </p>
      <div className={classes.head}>
        {proposal_sha256 !== null && (
          <Button
            size="sm"
            disabled={!mayApply}
            loading={apply.isPending}
            onClick={() => apply.mutate(proposal_sha256)}
          >
            Apply the correction
          </Button>
        )}
        {in_force && (
          <Button
            size="sm"
            variant="default"
            disabled={!mayApply}
            loading={undo.isPending}
            onClick={() => undo.mutate()}
          >
            Undo v{in_force.version_count}
          </Button>
        )}
      </div>
      {!mayApply && (proposal_sha256 !== null || in_force) && (
        <p className={classes.sub}>Your role may look. An engineer applies and undoes it.</p>
      )}
      {error && (
        <p className={classes.refusal} role="alert">
          {errorWords(error)}
        </p>
      )}
    </>
  );
}

export const gainWords = (proposal: Proposal) =>
  `Proposed from ${count(proposal.throw_count, "throw")}: on held-out throws the mean distance from the target goes from ${metres(proposal.before_m)} to ${metres(proposal.after_m)} (gain ${fixed(proposal.gain_low_m)} to ${fixed(proposal.gain_high_m)} m, 90 %).`;

function History({ versions }: { versions: readonly AimVersion[] }) {
  if (versions.length === 0) return null;
  return (
    <ul className={classes.rows} aria-label="Versions of the aim correction">
      {versions.map((version) => (
        <li key={version.version_count}>
          v{version.version_count} {version.cause === "undone" && "brought back "}by{" "}
          {version.created_by}, {zonedStamp(version.created_utc)}
          <span className={classes.sub}>
            {version.policy_id}, {count(version.content.throw_count, "throw")}
            {version.ended_utc === null
              ? ", in force"
              : `; ${version.end_reason} by ${version.ended_by}, ${zonedStamp(version.ended_utc)}`}
          </span>
        </li>
      ))}
    </ul>
  );
}
