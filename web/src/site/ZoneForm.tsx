import { Button, NumberInput, TextInput } from "@mantine/core";
import { IconTrash } from "@tabler/icons-react";
import classes from "./SitePanel.module.css";
import { type Corner, MAX_CORNERS, type Zone } from "./zones";

type Props = { zone: Zone; isDisabled: boolean; onChange: (zone: Zone) => void };

/** Name, reason, heights and corners of one zone, by keyboard. */
export function ZoneForm({ zone, isDisabled, onChange }: Props) {
  const set = (change: Partial<Zone>) => onChange({ ...zone, ...change });
  const number = (label: string, value: number, take: (value: number) => void) => (
    <NumberInput
      size="sm"
      label={label}
      decimalScale={3}
      allowedDecimalSeparators={[".", ","]}
      step={0.1}
      min={-60}
      max={60}
      disabled={isDisabled}
      value={value}
      onChange={(next) => typeof next === "number" && Number.isFinite(next) && take(next)}
    />
  );
  const corners = zone.corners_m as Corner[];
  const setCorner = (index: number, corner: Corner) =>
    set({ corners_m: corners.map((other, i) => (i === index ? corner : other)) });
  const addCorner = () => {
    const [a, b] = [corners[corners.length - 1], corners[0]] as [Corner, Corner];
    // Beside the middle of the last edge: on it, the polygon would be flat there.
    const middle: Corner = [(a[0] + b[0]) / 2 + 0.1, (a[1] + b[1]) / 2 + 0.1];
    set({ corners_m: [...corners, middle] });
  };
  return (
    <fieldset className={classes.fields} aria-label={`Heights and corners of ${zone.name}`}>
      <TextInput
        size="sm"
        label="Name"
        maxLength={40}
        className={classes.wide}
        disabled={isDisabled}
        value={zone.name}
        onChange={(event) => set({ name: event.currentTarget.value })}
      />
      <TextInput
        size="sm"
        label="What is there"
        maxLength={200}
        required
        className={classes.wide}
        disabled={isDisabled}
        value={zone.reason}
        onChange={(event) => set({ reason: event.currentTarget.value })}
      />
      {number("From, m", zone.bottom_m, (bottom_m) => set({ bottom_m }))}
      {number("To, m", zone.top_m, (top_m) => set({ top_m }))}
      <ol className={classes.corners} aria-label="Corners">
        {corners.map(([x, y], index) => (
          // biome-ignore lint/suspicious/noArrayIndexKey: corners have no name but their place
          <li key={index}>
            {number(`x ${index + 1}, m`, x, (next) => setCorner(index, [next, y]))}
            {number(`y ${index + 1}, m`, y, (next) => setCorner(index, [x, next]))}
            <Button
              variant="subtle"
              color="gray"
              disabled={isDisabled || corners.length <= 3}
              aria-label={`Delete corner ${index + 1}`}
              onClick={() => set({ corners_m: corners.filter((_, other) => other !== index) })}
            >
              <IconTrash size={18} aria-hidden />
            </Button>
          </li>
        ))}
      </ol>
      <Button
        variant="default"
        className={classes.wide}
        disabled={isDisabled || corners.length >= MAX_CORNERS}
        onClick={addCorner}
      >
        Add corner
      </Button>
    </fieldset>
  );
}
