import { Button, Menu, Modal, TextInput } from "@mantine/core";
import { IconAlertTriangle, IconBellOff, IconCheck, IconCircleX } from "@tabler/icons-react";
import { useState } from "react";
import { DriftOffers } from "../gap/DriftOffers";
import { useNow } from "../session/useNow";
import { useMay } from "../session/useSession";
import { errorWords } from "../words/errors";
import { age } from "../words/format";
import { ageSeconds, zonedStamp } from "../words/time";
import classes from "./Alerts.module.css";
import { type Alert, isSilent, needsLook, RULE_WORDS, toneOf } from "./attention";
import { useAlertActions } from "./useAlerts";

const SILENCES: readonly [string, number][] = [
  ["15 minutes", 900],
  ["1 hour", 3600],
  ["8 hours", 8 * 3600],
  ["24 hours", 24 * 3600],
];

/** One alert: what, since when, who has seen it; and what a person may do with it while it is open. */
export function AlertItem({ alert }: { alert: Alert }) {
  const now = useNow();
  const name = `${RULE_WORDS[alert.rule]}${alert.machine_id ? ` ${alert.machine_id}` : ""}`;
  const isCalling = needsLook(alert, now);
  const Mark = isCalling
    ? toneOf(alert.rule) === "alarm"
      ? IconCircleX
      : IconAlertTriangle
    : IconCheck;
  return (
    <li
      className={classes.alert}
      data-tone={isCalling ? toneOf(alert.rule) : undefined}
      data-testid="alert"
      aria-label={name}
    >
      <Mark size={20} aria-hidden className={classes.mark} />
      <div className={classes.what}>
        <p className={classes.title}>
          <strong>{alert.machine_id ?? "Server"}</strong>
          <span>{RULE_WORDS[alert.rule]}</span>
          <span className={classes.note}>{spanWords(alert, now)}</span>
        </p>
        <p>{alert.text}</p>
        {alert.rule === "drift" && alert.cleared_utc === null && <DriftOffers alert={alert} />}
        <Standing alert={alert} now={now} />
      </div>
      {alert.cleared_utc === null && <Actions alert={alert} name={name} now={now} />}
    </li>
  );
}

function spanWords(alert: Alert, now: number): string {
  const opened = zonedStamp(alert.opened_utc);
  if (alert.cleared_utc === null)
    return `for ${age(ageSeconds(alert.opened_utc, now))}, since ${opened}`;
  const lasted_s = (Date.parse(alert.cleared_utc) - Date.parse(alert.opened_utc)) / 1000;
  return `${opened}, for ${age(lasted_s)}`;
}

function Standing({ alert, now }: { alert: Alert; now: number }) {
  const silent = isSilent(alert, now);
  if (alert.acknowledged_by === null && !silent) return null;
  return (
    <p className={classes.note}>
      {alert.acknowledged_by !== null && (
        <span>
          Seen by {alert.acknowledged_by}, {zonedStamp(alert.acknowledged_utc)}
          {alert.note && `: ${alert.note}`}.{" "}
        </span>
      )}
      {silent && (
        <span>
          Silent until {zonedStamp(alert.silenced_until_utc)}, by {alert.silenced_by}.
        </span>
      )}
    </p>
  );
}

function Actions({ alert, name, now }: { alert: Alert; name: string; now: number }) {
  const [isOpen, setOpen] = useState(false);
  const mayAct = useMay("alert.acknowledge");
  const { acknowledge, silence } = useAlertActions(alert.alert_id);
  const error = silence.error;
  return (
    <div className={classes.actions}>
      {alert.acknowledged_by === null && (
        <Button
          size="sm"
          variant="default"
          disabled={!mayAct}
          aria-label={`Acknowledge: ${name}`}
          onClick={() => setOpen(true)}
        >
          Acknowledge
        </Button>
      )}
      <Menu position="bottom-end">
        <Menu.Target>
          <Button
            size="sm"
            variant="default"
            disabled={!mayAct}
            loading={silence.isPending}
            leftSection={<IconBellOff size={16} aria-hidden />}
            aria-label={`Silence: ${name}`}
          >
            Silence
          </Button>
        </Menu.Target>
        <Menu.Dropdown>
          {SILENCES.map(([words, duration_s]) => (
            <Menu.Item key={words} onClick={() => silence.mutate(duration_s)}>
              For {words}
            </Menu.Item>
          ))}
          {isSilent(alert, now) && (
            <Menu.Item onClick={() => silence.mutate(0)}>End the silence</Menu.Item>
          )}
        </Menu.Dropdown>
      </Menu>
      {error && (
        <p className={classes.refusal} role="alert">
          {errorWords(error)}
        </p>
      )}
      {isOpen && (
        <AcknowledgeDialog
          name={name}
          error={acknowledge.error}
          isPending={acknowledge.isPending}
          onConfirm={(note) => acknowledge.mutate(note, { onSuccess: () => setOpen(false) })}
          onClose={() => setOpen(false)}
        />
      )}
    </div>
  );
}

type DialogProps = {
  name: string;
  error: unknown;
  isPending: boolean;
  onConfirm: (note: string) => void;
  onClose: () => void;
};

function AcknowledgeDialog({ name, error, isPending, onConfirm, onClose }: DialogProps) {
  const [note, setNote] = useState("");
  const submit = (event: React.FormEvent) => {
    event.preventDefault();
    if (!isPending) onConfirm(note.trim());
  };
  return (
    <Modal opened onClose={onClose} title={`Acknowledge: ${name}`} centered>
      <form onSubmit={submit} className={classes.dialog}>
        <p>The alert stays open until its cause is gone. It no longer counts as new.</p>
        <TextInput
          label="Note"
          description="Kept with your name; may stay empty"
          value={note}
          maxLength={500}
          data-autofocus
          onChange={(event) => setNote(event.currentTarget.value)}
        />
        {error !== null && error !== undefined && (
          <p className={classes.refusal} role="alert">
            {errorWords(error)}
          </p>
        )}
        <Button type="submit" size="md" fullWidth loading={isPending}>
          I have seen it
        </Button>
      </form>
    </Modal>
  );
}
