import { Button, SegmentedControl, Select, Switch } from "@mantine/core";
import { useNavigate, useSearch } from "@tanstack/react-router";
import { AlertList } from "../alerts/AlertList";
import classes from "../alerts/Alerts.module.css";
import {
  type AlertSearch,
  inOrder,
  matches,
  parseAlertSearch,
  RULE_WORDS,
  RULES,
  type Rule,
} from "../alerts/attention";
import { playTone, useSoundChoice } from "../alerts/useAlertSound";
import { useClearedAlerts, useOpenAlerts } from "../alerts/useAlerts";
import { WebhookPanel } from "../alerts/WebhookPanel";
import { GateSentence } from "../operate/GateSentence";
import { useLive } from "../session/liveStore";
import { useNow } from "../session/useNow";
import { useMay } from "../session/useSession";
import { errorWords } from "../words/errors";

const FILTERED = "No alert of this kind.";

/** Alerts: what is wrong now, who has seen it, and what was wrong before. */
export function AlertsPage() {
  const search: AlertSearch = useSearch({ from: "/frame/alerts" });
  const navigate = useNavigate({ from: "/alerts" });
  const change = (next: Partial<AlertSearch>) =>
    void navigate({ search: parseAlertSearch({ ...search, ...next }), replace: true });
  const mayAct = useMay("alert.acknowledge");
  const mayNotify = useMay("admin");
  const state = search.state === "webhooks" && !mayNotify ? undefined : search.state;
  return (
    <div className={classes.page}>
      <header className={classes.head}>
        <h1>Alerts</h1>
        <SegmentedControl
          aria-label="Which alerts"
          data={[
            { value: "open", label: "Open" },
            { value: "cleared", label: "Cleared" },
            ...(mayNotify ? [{ value: "webhooks", label: "Webhooks" }] : []),
          ]}
          value={state ?? "open"}
          onChange={(value) => change({ state: value as AlertSearch["state"] })}
        />
        {state !== "webhooks" && <Filters search={search} onChange={change} />}
        <SoundSwitch />
      </header>
      {!mayAct && <p className={classes.note}>Your role may look, not change.</p>}
      {state === "webhooks" && <WebhookPanel />}
      {state === "cleared" && <Cleared search={search} />}
      {state === undefined && <Open search={search} />}
    </div>
  );
}

type FilterProps = { search: AlertSearch; onChange: (next: Partial<AlertSearch>) => void };

function Filters({ search, onChange }: FilterProps) {
  const machines = useLive((live) => live.machines);
  const select = { size: "sm", clearable: true, classNames: { root: classes.field } } as const;
  return (
    <form className={classes.filters} aria-label="Filters" onSubmit={(e) => e.preventDefault()}>
      <Select
        {...select}
        placeholder="Machine"
        aria-label="Machine"
        data={Object.keys(machines).sort()}
        value={search.machine ?? null}
        onChange={(value) => onChange({ machine: value ?? undefined })}
      />
      <Select
        {...select}
        placeholder="Kind"
        aria-label="Kind"
        data={RULES.map((rule) => ({ value: rule, label: RULE_WORDS[rule] }))}
        value={search.rule ?? null}
        onChange={(value) => onChange({ rule: (value as Rule | null) ?? undefined })}
      />
    </form>
  );
}

function SoundSwitch() {
  const [isOn, choose] = useSoundChoice();
  return (
    <Switch
      label="Sound"
      checked={isOn}
      onChange={(event) => {
        choose(event.currentTarget.checked);
        // The press that asks for it also lets the browser play it, and shows how it sounds.
        if (event.currentTarget.checked) playTone();
      }}
    />
  );
}

function Open({ search }: { search: AlertSearch }) {
  const all = useOpenAlerts();
  const isLoaded = useLive((live) => live.isLoaded);
  const shown = inOrder(
    all.filter((alert) => matches(alert, search)),
    useNow(),
  );
  if (!isLoaded) return null;
  if (shown.length === 0) {
    return <GateSentence sentence={all.length === 0 ? "No alert is open." : FILTERED} />;
  }
  return <AlertList alerts={shown} label="Open alerts" />;
}

function Cleared({ search }: { search: AlertSearch }) {
  const pages = useClearedAlerts(search);
  if (pages.isError) return <GateSentence sentence={errorWords(pages.error)} />;
  if (pages.data && pages.rows.length === 0) {
    const isFiltered = search.machine !== undefined || search.rule !== undefined;
    return <GateSentence sentence={isFiltered ? FILTERED : "No alert has been cleared yet."} />;
  }
  return (
    <>
      <AlertList alerts={pages.rows} label="Cleared alerts" />
      {pages.hasNextPage && (
        <Button
          variant="default"
          onClick={() => void pages.fetchNextPage()}
          loading={pages.isFetchingNextPage}
        >
          Older
        </Button>
      )}
    </>
  );
}
