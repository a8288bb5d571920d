import type { GROUP_SYMBOLS } from "./groups";

const SHAPES: Record<(typeof GROUP_SYMBOLS)[number], string> = {
  circle: "M6 1.5a4.5 4.5 0 1 0 .01 0z",
  square: "M2 2h8v8H2z",
  triangle: "M6 1.5 11 10.5H1z",
  diamond: "M6 .8 11 6 6 11.2 1 6z",
};

/** The mark of a group in legends. */
export function GroupMark({
  colour,
  symbol,
}: {
  colour: string;
  symbol: (typeof GROUP_SYMBOLS)[number];
}) {
  return (
    <svg width="12" height="12" viewBox="0 0 12 12" aria-hidden="true">
      <path d={SHAPES[symbol]} fill={colour} />
    </svg>
  );
}
