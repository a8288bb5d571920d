import { Button, Modal, NumberInput, SegmentedControl } from "@mantine/core";
import { useState } from "react";
import type { Schema } from "../session/client";
import { errorWords } from "../words/errors";
import classes from "./Validation.module.css";

type Request = Schema["ValidationRequest"];
type Protocol = "short" | "full";

/** As in evaluation/validation/protocol.py. */
const USUAL: Record<Protocol, { throws: number; units: number }> = {
  short: { throws: 20, units: 2 },
  full: { throws: 200, units: 10 },
};

type Props = {
  policyId: string;
  isPending: boolean;
  error: unknown;
  onStart: (request: Request) => void;
  onClose: () => void;
};

/** Which throws a validation makes. */
export function StartDialog({ policyId, isPending, error, onStart, onClose }: Props) {
  const [protocol, setProtocol] = useState<Protocol>("short");
  const [throws, setThrows] = useState(USUAL.short.throws);
  const [units, setUnits] = useState(USUAL.short.units);
  const choose = (value: string) => {
    const chosen = value as Protocol;
    setProtocol(chosen);
    setThrows(USUAL[chosen].throws);
    setUnits(USUAL[chosen].units);
  };
  const submit = (event: React.FormEvent) => {
    event.preventDefault();
    if (!isPending) onStart({ protocol, throws_per_target: throws, unseen_unit_count: units });
  };
  return (
    <Modal opened onClose={onClose} title={`Validate ${policyId}`} centered>
      <form className={classes.fields} onSubmit={submit}>
        <p>
          Throws with it and with the active version in virtual machines, at low priority on the
          server; nothing moves. Short takes minutes, full up to hours. Seed and machines are drawn
          now.
        </p>
        <SegmentedControl
          aria-label="Protocol"
          size="md"
          value={protocol}
          onChange={choose}
          data={[
            { value: "short", label: "Short" },
            { value: "full", label: "Full (the paper's)" },
          ]}
        />
        <NumberInput
          label="Throws at each target"
          size="md"
          min={2}
          max={1000}
          allowDecimal={false}
          clampBehavior="strict"
          value={throws}
          onChange={(value) => setThrows(Number(value) || 2)}
        />
        <NumberInput
          label="Machines that served no training, besides the nominal one"
          size="md"
          min={0}
          max={50}
          allowDecimal={false}
          clampBehavior="strict"
          value={units}
          onChange={(value) => setUnits(Number(value) || 0)}
        />
        {error !== null && error !== undefined && (
          <p className={classes.refusal} role="alert">
            {errorWords(error)}
          </p>
        )}
        <Button type="submit" size="md" fullWidth loading={isPending}>
          Validate
        </Button>
      </form>
    </Modal>
  );
}
