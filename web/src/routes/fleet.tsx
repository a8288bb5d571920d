import { Button, SegmentedControl, Select, TextInput } from "@mantine/core";
import { useNavigate, useSearch } from "@tanstack/react-router";
import { useState } from "react";
import { useOpenAlerts } from "../alerts/useAlerts";
import { AddMachine } from "../fleet/AddMachine";
import classes from "../fleet/Fleet.module.css";
import { FleetTable } from "../fleet/FleetTable";
import { RetiredMachines } from "../fleet/RetiredMachines";
import {
  chosenRows,
  type FleetSearch,
  fleetRows,
  parseFleetSearch,
  SORTS,
  STANDINGS,
} from "../fleet/rows";
import { type FleetRecord, useFleet } from "../fleet/useFleet";
import { YardMap } from "../fleet/YardMap";
import { StopAllButton } from "../machine/StopAllButton";
import { GateSentence } from "../operate/GateSentence";
import { useLive } from "../session/liveStore";
import { useNow } from "../session/useNow";
import { useMay } from "../session/useSession";
import { errorWords } from "../words/errors";

const NO_RECORDS: readonly FleetRecord[] = [];

/** Fleet: every machine of this site with its state, versions, accuracy and alerts; lost ones stay. */
export function FleetPage() {
  const search: FleetSearch = useSearch({ from: "/frame/fleet" });
  const navigate = useNavigate({ from: "/fleet" });
  const machines = useLive((live) => live.machines);
  const isLoaded = useLive((live) => live.isLoaded);
  const records = useFleet();
  const alerts = useOpenAlerts();
  const all = fleetRows(machines, records.data ?? NO_RECORDS, alerts, useNow());
  const [isAdding, setAdding] = useState(false);
  const mayAdd = useMay("machine.enrol");
  const rows = chosenRows(all, search);
  const change = (next: FleetSearch) =>
    void navigate({ search: parseFleetSearch({ ...search, ...next }), replace: true });
  return (
    <div className={classes.page}>
      <header className={classes.head}>
        <h1>Fleet</h1>
        {all.length > 0 && <Choice search={search} onChange={change} />}
        <span className={classes.spread} />
        {!mayAdd && <span className={classes.dim}>An admin may add machines.</span>}
        <Button size="sm" disabled={!mayAdd} onClick={() => setAdding(true)}>
          Add machine
        </Button>
      </header>
      {records.isError && <p className={classes.refusal}>{errorWords(records.error)}</p>}
      {isLoaded && all.length === 0 && (
        <GateSentence sentence="No machine has connected to this server yet. Add one." />
      )}
      {all.length > 0 && rows.length === 0 && (
        <GateSentence sentence="No machine matches. Clear a filter." />
      )}
      {rows.length > 0 && (search.view ? <YardMap rows={rows} /> : <FleetTable rows={rows} />)}
      {all.length > 0 && <StopAllButton />}
      <RetiredMachines />
      {isAdding && <AddMachine onClose={() => setAdding(false)} />}
    </div>
  );
}

type ChoiceProps = { search: FleetSearch; onChange: (next: FleetSearch) => void };

function Choice({ search, onChange }: ChoiceProps) {
  const select = { size: "sm", classNames: { root: classes.field } } as const;
  const data = (words: Record<string, string>) =>
    Object.entries(words).map(([value, label]) => ({ value, label }));
  return (
    <>
      <SegmentedControl
        aria-label="Shown as"
        data={[
          { value: "list", label: "List" },
          { value: "map", label: "Map" },
        ]}
        value={search.view ?? "list"}
        onChange={(value) => onChange({ view: value === "map" ? "map" : undefined })}
      />
      <TextInput
        {...select}
        aria-label="Find a machine"
        placeholder="Find: name, tag, version"
        value={search.find ?? ""}
        onChange={(event) => onChange({ find: event.currentTarget.value })}
      />
      <Select
        {...select}
        clearable
        aria-label="State"
        placeholder="State"
        data={data(STANDINGS)}
        value={search.standing ?? null}
        onChange={(value) =>
          onChange({ standing: (value as FleetSearch["standing"]) ?? undefined })
        }
      />
      <Select
        {...select}
        allowDeselect={false}
        aria-label="Order"
        data={data(SORTS)}
        value={search.sort ?? "machine"}
        onChange={(value) => onChange({ sort: (value as FleetSearch["sort"]) ?? undefined })}
      />
    </>
  );
}
