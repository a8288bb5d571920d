import { Button, NumberInput, Select, TextInput } from "@mantine/core";
import { IconDownload } from "@tabler/icons-react";
import { useLive } from "../session/liveStore";
import classes from "./FilterBar.module.css";
import { csvHref, type Filters, isFiltered } from "./filters";
import { OUTCOMES, outcomeWord } from "./outcome";
import { usePolicies } from "./useThrows";

type Props = {
  filters: Filters;
  onChange: (change: Partial<Filters>) => void;
  onClear: () => void;
};

/** Filters of the history; each stands in the address. */
export function FilterBar({ filters, onChange, onClear }: Props) {
  const machines = useLive((live) => live.machines);
  const policies = usePolicies().data ?? [];
  const select = { size: "xs", clearable: true, classNames: { root: classes.field } } as const;
  const range = {
    size: "xs",
    min: 0,
    max: 60,
    step: 0.5,
    decimalScale: 2,
    hideControls: true,
  } as const;
  return (
    <form className={classes.bar} aria-label="Filters" onSubmit={(event) => event.preventDefault()}>
      <Select
        {...select}
        placeholder="Machine"
        aria-label="Machine"
        data={Object.keys(machines).sort()}
        value={filters.machine ?? null}
        onChange={(value) => onChange({ machine: value ?? undefined })}
      />
      <Select
        {...select}
        placeholder="Mode"
        aria-label="Mode"
        data={[
          { value: "2d", label: "2D" },
          { value: "3d", label: "3D" },
        ]}
        value={filters.mode ?? null}
        onChange={(value) => onChange({ mode: (value as Filters["mode"]) ?? undefined })}
      />
      <Select
        {...select}
        placeholder="Policy"
        aria-label="Policy"
        data={policies.map((p) => ({ value: p.policy_sha256, label: p.policy_id }))}
        value={filters.policy ?? null}
        onChange={(value) => onChange({ policy: value ?? undefined })}
      />
      <Select
        {...select}
        placeholder="Outcome"
        aria-label="Outcome"
        data={OUTCOMES.map((value) => ({ value, label: outcomeWord(value) }))}
        value={filters.outcome ?? null}
        onChange={(value) => onChange({ outcome: (value as Filters["outcome"]) ?? undefined })}
      />
      <TextInput
        size="xs"
        classNames={{ root: classes.field }}
        placeholder="Person"
        aria-label="Person"
        key={`person ${filters.operator ?? ""}`}
        defaultValue={filters.operator ?? ""}
        onBlur={(event) => onChange({ operator: event.currentTarget.value.trim() || undefined })}
        onKeyDown={(event) => event.key === "Enter" && event.currentTarget.blur()}
      />
      <NumberInput
        {...range}
        classNames={{ root: classes.short }}
        placeholder="from, m"
        aria-label="Target range from, metres"
        value={filters.min ?? ""}
        onChange={(value) => onChange({ min: typeof value === "number" ? value : undefined })}
      />
      <NumberInput
        {...range}
        classNames={{ root: classes.short }}
        placeholder="to, m"
        aria-label="Target range to, metres"
        value={filters.max ?? ""}
        onChange={(value) => onChange({ max: typeof value === "number" ? value : undefined })}
      />
      <TextInput
        size="xs"
        type="date"
        classNames={{ root: classes.date }}
        aria-label="Since"
        leftSection={<span className={classes.prefix}>since</span>}
        leftSectionWidth={42}
        value={filters.since ?? ""}
        onChange={(event) => onChange({ since: event.currentTarget.value || undefined })}
      />
      <TextInput
        size="xs"
        type="date"
        classNames={{ root: classes.date }}
        aria-label="Until"
        leftSection={<span className={classes.prefix}>until</span>}
        leftSectionWidth={42}
        value={filters.until ?? ""}
        onChange={(event) => onChange({ until: event.currentTarget.value || undefined })}
      />
      {isFiltered(filters) && (
        <Button size="xs" variant="default" onClick={onClear}>
          Clear
        </Button>
      )}
      <Button
        size="xs"
        variant="default"
        component="a"
        href={csvHref(filters)}
        download
        leftSection={<IconDownload size={14} aria-hidden />}
        ml="auto"
      >
        CSV
      </Button>
    </form>
  );
}
