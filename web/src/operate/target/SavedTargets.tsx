import { ActionIcon, Button, TextInput } from "@mantine/core";
import { IconX } from "@tabler/icons-react";
import { useState } from "react";
import { bearingWords, heightWords, metres } from "../../words/format";
import { pointOf, type SavedTarget, useSavedTargets } from "./rememberedTargets";
import classes from "./SavedTargets.module.css";
import type { Target } from "./target";

type Props = {
  machineId: string;
  target: Target | null;
  onTarget: (target: Target) => void;
};

/** Named targets and the last ones thrown at; one press aims there. */
export function SavedTargets({ machineId, target, onTarget }: Props) {
  const { all, keep, forget } = useSavedTargets(machineId);
  const [name, setName] = useState("");
  const submit = (event: React.FormEvent) => {
    event.preventDefault();
    if (!target || name.trim() === "") return;
    keep(name.trim(), target);
    setName("");
  };
  const row = (one: SavedTarget) => (
    <button type="button" className={classes.target} onClick={() => onTarget(pointOf(one))}>
      {one.name && <strong>{one.name}</strong>} {placeWords(pointOf(one))}
    </button>
  );
  return (
    <details className={classes.saved}>
      <summary>Named and recent targets</summary>
      <ul className={classes.list} aria-label="Named targets">
        {all.named.map((one) => (
          <li key={one.name}>
            {row(one)}
            <ActionIcon
              variant="subtle"
              color="gray"
              aria-label={`Forget ${one.name}`}
              onClick={() => forget(one.name)}
            >
              <IconX size={16} aria-hidden />
            </ActionIcon>
          </li>
        ))}
      </ul>
      <ul className={classes.list} aria-label="Recent targets">
        {all.recent.map((one) => (
          <li key={`${one.x_m} ${one.y_m} ${one.z_m}`}>{row(one)}</li>
        ))}
      </ul>
      <form className={classes.keep} onSubmit={submit} aria-label="Name this target">
        <TextInput
          size="sm"
          aria-label="Name of this target"
          placeholder="Name of this target"
          maxLength={40}
          value={name}
          onChange={(event) => setName(event.currentTarget.value)}
        />
        <Button type="submit" size="sm" variant="default" disabled={!target || name.trim() === ""}>
          Keep
        </Button>
      </form>
    </details>
  );
}

const placeWords = ({ range_m, azimuth_rad, z_m }: Target) =>
  `${metres(range_m)}, ${bearingWords(azimuth_rad)}${heightWords(z_m)}`;
