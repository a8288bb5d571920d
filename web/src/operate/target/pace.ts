/** How fast a throw is made, from 0, careful, to 1, fast; only policies trained for it heed it. */

/** The server's own default (machine/conventions.py): careful. */
export const DEFAULT_PACE_RATIO = 0;
export const PACE_STEP = 0.05;

export const paceWord = (pace_ratio: number): string =>
  pace_ratio < 0.375 ? "careful" : pace_ratio > 0.625 ? "fast" : "balanced";

/** "0.25, careful": the number with a word for it. */
export const paceWords = (pace_ratio: number): string =>
  `${pace_ratio.toFixed(2)}, ${paceWord(pace_ratio)}`;
