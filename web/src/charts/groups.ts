/** Colour and shape of groups: both differ, so that colour is never the only sign. */

export const GROUP_COLOURS = [
  "var(--chart-1)",
  "var(--chart-2)",
  "var(--chart-3)",
  "var(--chart-4)",
] as const;

export const GROUP_SYMBOLS = ["circle", "square", "triangle", "diamond"] as const;

export function groupStyle(groups: readonly { group: string }[], group: string) {
  const index = Math.max(
    0,
    groups.findIndex((other) => other.group === group),
  );
  return {
    colour: GROUP_COLOURS[index % GROUP_COLOURS.length] ?? GROUP_COLOURS[0],
    symbol: GROUP_SYMBOLS[index % GROUP_SYMBOLS.length] ?? GROUP_SYMBOLS[0],
  };
}
