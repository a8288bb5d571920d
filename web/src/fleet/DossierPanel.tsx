import { Button, TextInput } from "@mantine/core";
import { IconDownload } from "@tabler/icons-react";
import { useState } from "react";
import { useMay } from "../session/useSession";
import { errorWords } from "../words/errors";
import { bytes, count } from "../words/format";
import { dayStart } from "../words/time";
import classes from "./Fleet.module.css";
import { dossierHref, useDossierExtent } from "./useFleet";

/** A machine's throws of some days, with all that belongs to them, as one signed file. */
export function DossierPanel({ machineId }: { machineId: string }) {
  const may = useMay("audit.read");
  const [first, setFirst] = useState("");
  const [last, setLast] = useState("");
  const isPeriod = first !== "" && last !== "" && first <= last;
  const period = isPeriod ? { since: dayStart(first), until: dayStart(last, true) } : null;
  const extent = useDossierExtent(machineId, may ? period : null);
  if (!may) return null;
  const sentence = !isPeriod
    ? first && last
      ? "The last day lies before the first."
      : "Choose the first and the last day."
    : extent.isError
      ? errorWords(extent.error)
      : extent.data
        ? (extent.data.problem ??
          `${count(extent.data.throw_count, "throw")}, ${bytes(extent.data.log_bytes)} of logs.`)
        : "";
  const isReady = period !== null && extent.data?.problem === null;
  return (
    <section className={classes.panel} aria-label="Dossier">
      <h2>Dossier</h2>
      <p className={classes.dim}>
        Throws with plan, preview, policy, log, impacts and audit, signed by the site.
      </p>
      <div className={classes.head}>
        <TextInput
          size="sm"
          type="date"
          label="First day"
          value={first}
          onChange={(event) => setFirst(event.currentTarget.value)}
        />
        <TextInput
          size="sm"
          type="date"
          label="Last day"
          value={last}
          onChange={(event) => setLast(event.currentTarget.value)}
        />
      </div>
      <p aria-live="polite">{sentence}</p>
      {isReady && (
        <Button
          variant="default"
          size="sm"
          component="a"
          href={dossierHref(machineId, period)}
          download
          leftSection={<IconDownload size={16} aria-hidden />}
        >
          Export
        </Button>
      )}
    </section>
  );
}
