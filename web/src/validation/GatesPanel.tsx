import { Button, NumberInput } from "@mantine/core";
import { useState } from "react";
import { ConfirmDialog } from "../policies/ConfirmDialog";
import type { Schema } from "../session/client";
import { useMay } from "../session/useSession";
import { errorWords } from "../words/errors";
import { zonedStamp } from "../words/time";
import { ScrollTable } from "./ScrollTable";
import { type Gates, useGates, useSetGates } from "./useValidation";
import classes from "./Validation.module.css";
import { gateNumber } from "./words";

type View = Schema["GatesView"];
type Field = { key: keyof Gates; label: string; unit: "m" | "ratio" | "s" | "times" };

const FIELDS: readonly Field[] = [
  { key: "sd_m", label: "Spread at most", unit: "m" },
  { key: "mean_m", label: "Mean error at most", unit: "m" },
  { key: "landed_ratio", label: "Landed at least", unit: "ratio" },
  { key: "latency_s", label: "One run at most", unit: "s" },
  { key: "worse_ratio", label: "Spread over the active version's at most", unit: "times" },
];
/** Shown unit over stored unit, and its name. */
const SHOWN = {
  m: { scale: 1, suffix: " m" },
  ratio: { scale: 100, suffix: " %" },
  s: { scale: 1000, suffix: " ms" },
  times: { scale: 1, suffix: " times" },
};

/** Gates that the next validations are checked against. */
export function GatesPanel() {
  const gates = useGates();
  const maySet = useMay("policy.approve");
  const [mode, setMode] = useState<View["mode"] | null>(null);
  if (gates.isError) return <p className={classes.refusal}>{errorWords(gates.error)}</p>;
  if (!gates.data) return null;
  const chosen = gates.data.find((one) => one.mode === mode);
  return (
    <section className={classes.panel} aria-label="Gates of validations">
      <h2>Gates of validations</h2>
      <ScrollTable label="Gates by mode">
        <thead>
          <tr>
            <th scope="col">Gate</th>
            {gates.data.map((one) => (
              <th scope="col" key={one.mode}>
                {one.mode.toUpperCase()}
              </th>
            ))}
          </tr>
        </thead>
        <tbody>
          {FIELDS.map((field) => (
            <tr key={field.key}>
              <th scope="row">{field.label}</th>
              {gates.data.map((one) => (
                <td key={one.mode}>{gateNumber(one.gates[field.key], field.unit)}</td>
              ))}
            </tr>
          ))}
          <tr>
            <th scope="row">Set by</th>
            {gates.data.map((one) => (
              <td key={one.mode}>
                {one.set_by === null || one.set_utc === null
                  ? "defaults"
                  : `${one.set_by}, ${zonedStamp(one.set_utc)}: ${one.reason}`}
              </td>
            ))}
          </tr>
        </tbody>
      </ScrollTable>
      {maySet && (
        <div className={classes.buttons}>
          {gates.data.map((one) => (
            <Button key={one.mode} variant="default" size="md" onClick={() => setMode(one.mode)}>
              Change the gates of {one.mode.toUpperCase()}
            </Button>
          ))}
        </div>
      )}
      {chosen && <GatesDialog view={chosen} onClose={() => setMode(null)} />}
    </section>
  );
}

function GatesDialog({ view, onClose }: { view: View; onClose: () => void }) {
  const [gates, setGates] = useState<Gates>(view.gates);
  const set = useSetGates(view.mode);
  return (
    <ConfirmDialog
      title={`Gates of ${view.mode.toUpperCase()}`}
      action="Set the gates"
      isPending={set.isPending}
      error={set.error}
      onConfirm={(reason) => set.mutate({ gates, reason }, { onSuccess: onClose })}
      onClose={onClose}
    >
      <p>Validations from now on are checked against these; earlier results stay as they are.</p>
      {FIELDS.map(({ key, label, unit }) => (
        <NumberInput
          key={key}
          label={label}
          size="md"
          suffix={SHOWN[unit].suffix}
          min={0}
          decimalScale={3}
          value={Number((gates[key] * SHOWN[unit].scale).toFixed(3))}
          onChange={(value) => setGates({ ...gates, [key]: Number(value) / SHOWN[unit].scale })}
        />
      ))}
    </ConfirmDialog>
  );
}
