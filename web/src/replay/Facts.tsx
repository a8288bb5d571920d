import { Anchor, Button } from "@mantine/core";
import { IconDownload } from "@tabler/icons-react";
import { paceWords } from "../operate/target/pace";
import type { Schema } from "../session/client";
import { useMay } from "../session/useSession";
import { outcomeSentence } from "../throws/outcome";
import { bearingWords, bytes, heightWords, metres, seconds, speed } from "../words/format";
import { Hash } from "../words/Hash";
import { localStamp, zoneName } from "../words/time";
import classes from "./Facts.module.css";

type Detail = Schema["ThrowDetail"];

/** People and versions: who threw what, with which policy, twin and model. */
export function Facts({ detail }: { detail: Detail }) {
  const { row, plan } = detail;
  const facts: [string, React.ReactNode][] = [
    ["Outcome", outcomeSentence(row)],
    [
      "Target",
      `${metres(row.target.range_m)}, ${bearingWords(row.target.azimuth_rad)}${heightWords(row.target.z_m)}`,
    ],
    ["Pace", paceWords(row.pace_ratio)],
    ["Person", row.operator],
    ["Machine", row.machine_id],
    [`Time, ${zoneName(new Date(row.created_utc))}`, localStamp(row.created_utc)],
    ["Release speed", speed(row.release_speed_m_per_s)],
    ["Duration", seconds(row.throw_duration_s, 1)],
    [
      "Policy",
      <span key="policy">
        {row.policy_id} <Hash value={row.policy_sha256} name="Policy" />
      </span>,
    ],
    ["Machine model", <Hash key="model" value={plan?.model_sha256} name="Machine model" />],
    ["Twin profile", plan ? `version ${plan.twin_profile_version}` : "–"],
    ["Plan", <Hash key="plan" value={plan?.plan_hash} name="Plan" />],
    ["Control epoch", detail.epoch_count],
    ["Throw", row.throw_id],
  ];
  return (
    <dl className={classes.facts}>
      {facts.map(([name, value]) => (
        <div key={name}>
          <dt>{name}</dt>
          <dd>{value}</dd>
        </div>
      ))}
    </dl>
  );
}

/** The machine's own recording, and all that belongs to the throw in one signed file. */
export function Files({ detail }: { detail: Detail }) {
  return (
    <>
      <LogFiles detail={detail} />
      <DossierFile row={detail.row} />
    </>
  );
}

function DossierFile({ row }: { row: Detail["row"] }) {
  const may = useMay("audit.read");
  if (!may || row.phase !== "ended") return null;
  return (
    <>
      <Button
        variant="default"
        fullWidth
        component="a"
        href={`/api/v1/throws/${encodeURIComponent(row.throw_id)}/dossier`}
        download
        leftSection={<IconDownload size={16} aria-hidden />}
      >
        Dossier, signed
      </Button>
      <p className={classes.note}>
        Plan, preview, policy, log, impacts and audit in one file, with a page to read.
      </p>
    </>
  );
}

function LogFiles({ detail }: { detail: Detail }) {
  const { log, row } = detail;
  if (!log) return <p className={classes.note}>The machine has not sent its log yet.</p>;
  return (
    <>
      <Button
        variant="default"
        fullWidth
        component="a"
        href={`/api/v1/throws/${encodeURIComponent(row.throw_id)}/log`}
        download
        leftSection={<IconDownload size={16} aria-hidden />}
      >
        Throw log, MCAP, {bytes(log.size_bytes)}
      </Button>
      <Anchor size="sm" href={`/api/v1/throws/${encodeURIComponent(row.throw_id)}/csv`} download>
        The same as CSV
      </Anchor>
      <p className={classes.note}>
        sha256 <Hash value={log.log_sha256} name="Log" />, received {localStamp(log.received_utc)}
      </p>
    </>
  );
}
