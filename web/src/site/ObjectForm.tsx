import { NumberInput, TextInput } from "@mantine/core";
import { azimuthOf, placed, rangeOf, type SiteObject } from "./objects";
import classes from "./SitePanel.module.css";

const DEGREES = 180 / Math.PI;

type Props = {
  item: SiteObject;
  isDisabled: boolean;
  onChange: (item: SiteObject) => void;
};

/** Name, place and size of one object. */
export function ObjectForm({ item, isDisabled, onChange }: Props) {
  const set = (change: Partial<SiteObject>) => onChange({ ...item, ...change });
  const isPit = item.kind === "pit";
  const number = (label: string, value: number, take: (value: number) => void, rest = {}) => (
    <NumberInput
      size="sm"
      label={label}
      decimalScale={2}
      allowedDecimalSeparators={[".", ","]}
      step={0.1}
      disabled={isDisabled}
      value={Number(value.toFixed(2))}
      onChange={(next) => typeof next === "number" && Number.isFinite(next) && take(next)}
      {...rest}
    />
  );
  return (
    <fieldset className={classes.fields} aria-label={`Place and size of ${item.name}`}>
      <TextInput
        size="sm"
        label="Name"
        maxLength={40}
        className={classes.wide}
        disabled={isDisabled}
        value={item.name}
        onChange={(event) => set({ name: event.currentTarget.value })}
      />
      {number("Range, m", rangeOf(item), (v) => onChange(placed(item, v, azimuthOf(item))), {
        min: 0,
        max: 60,
      })}
      {number(
        "Azimuth, °",
        azimuthOf(item) * DEGREES,
        (v) => onChange(placed(item, rangeOf(item), v / DEGREES)),
        { min: -180, max: 180, step: 1 },
      )}
      {number("Turn, °", (item.turn_rad ?? 0) * DEGREES, (v) => set({ turn_rad: v / DEGREES }), {
        min: -180,
        max: 180,
        step: 5,
      })}
      {number("Length, m", item.length_m, (v) => set({ length_m: v }), { min: 0.2, max: 30 })}
      {number("Width, m", item.width_m, (v) => set({ width_m: v }), { min: 0.2, max: 30 })}
      {number(isPit ? "Depth, m" : "Height, m", item.height_m, (v) => set({ height_m: v }), {
        min: 0.1,
        max: isPit ? 1 : 5,
      })}
      {item.kind === "box" &&
        number("Base, m", item.base_height_m ?? 0, (v) => set({ base_height_m: v }), {
          min: 0,
          max: 5,
        })}
      {item.kind === "pile" &&
        number("Flat top, %", (item.top_ratio ?? 0) * 100, (v) => set({ top_ratio: v / 100 }), {
          min: 0,
          max: 95,
          step: 5,
        })}
    </fieldset>
  );
}
