/** Numbers as people read them: fixed digits, unit, a sign and a word on every error. */

const MINUS = "\u2212";
const NONE = "\u2013";

type Maybe = number | null | undefined;

function missing(value: Maybe): value is null | undefined {
  return value === null || value === undefined || !Number.isFinite(value);
}

/** Fixed digits with a true minus sign and without "-0.00"; an en dash for what is not known. */
export function fixed(value: Maybe, digits = 2): string {
  if (missing(value)) return NONE;
  const text = Math.abs(value).toFixed(digits);
  return value < 0 && Number(text) !== 0 ? MINUS + text : text;
}

/** Like `fixed` with a sign for both directions. */
export function signed(value: Maybe, digits = 2): string {
  if (missing(value)) return NONE;
  const text = fixed(value, digits);
  return value > 0 && Number(text) !== 0 ? `+${text}` : text;
}

export const metres = (value: Maybe, digits = 2) =>
  missing(value) ? NONE : `${fixed(value, digits)} m`;

export const seconds = (value: Maybe, digits = 2) =>
  missing(value) ? NONE : `${fixed(value, digits)} s`;

export const speed = (value: Maybe) => (missing(value) ? NONE : `${fixed(value, 2)} m/s`);

export const degrees = (value_rad: Maybe, digits = 1) =>
  missing(value_rad) ? NONE : `${fixed((value_rad * 180) / Math.PI, digits)}°`;

export const percent = (ratio: Maybe, digits = 0) =>
  missing(ratio) ? NONE : `${fixed(ratio * 100, digits)} %`;

/** Error along the target line: "+0.12 m long", "−0.08 m short". */
export function downrangeWords(error_m: Maybe): string {
  if (missing(error_m)) return NONE;
  const text = `${signed(error_m)} m`;
  if (Math.abs(error_m) < 0.005) return `${text} on range`;
  return `${text} ${error_m > 0 ? "long" : "short"}`;
}

/** Error across it, left positive as in frame `throw`: "+0.05 m left", "−0.05 m right". */
export function crossrangeWords(error_m: Maybe): string {
  if (missing(error_m)) return NONE;
  const text = `${signed(error_m)} m`;
  if (Math.abs(error_m) < 0.005) return `${text} on line`;
  return `${text} ${error_m > 0 ? "left" : "right"}`;
}

/** Bearing from straight ahead: "12.0° left", "0.0° ahead". */
export function bearingWords(azimuth_rad: Maybe): string {
  if (missing(azimuth_rad)) return NONE;
  const deg = (azimuth_rad * 180) / Math.PI;
  if (Math.abs(deg) < 0.05) return "0.0° ahead";
  return `${fixed(Math.abs(deg), 1)}° ${deg > 0 ? "left" : "right"}`;
}

/** The same for narrow tables: "12.0° L", "3.5° R", "0.0°". */
export function bearingShort(azimuth_rad: Maybe): string {
  if (missing(azimuth_rad)) return NONE;
  const deg = (azimuth_rad * 180) / Math.PI;
  if (Math.abs(deg) < 0.05) return "0.0°";
  return `${fixed(Math.abs(deg), 1)}° ${deg > 0 ? "L" : "R"}`;
}

/** Height of a target off the ground, to follow its range: ", +1.20 m high", ", 0.80 m deep"; nothing on it. */
export function heightWords(z_m: Maybe, before = ", "): string {
  if (missing(z_m) || Math.abs(z_m) < 0.005) return "";
  return before + (z_m > 0 ? `${signed(z_m)} m high` : `${fixed(-z_m)} m deep`);
}

/** How long ago, coarse enough not to flicker: "3 s", "14 min", "2 h", "5 d". */
export function age(value_s: Maybe): string {
  if (missing(value_s)) return NONE;
  const whole = Math.max(0, Math.floor(value_s));
  if (whole < 90) return `${whole} s`;
  if (whole < 5400) return `${Math.floor(whole / 60)} min`;
  if (whole < 172800) return `${Math.floor(whole / 3600)} h`;
  return `${Math.floor(whole / 86400)} d`;
}

/** Reading of an hour meter: "0.3 h", "1204.0 h". */
export const hours = (value_s: Maybe) =>
  missing(value_s) ? NONE : `${fixed(value_s / 3600, 1)} h`;

/** File size in the unit a person would choose. */
export function bytes(count: Maybe): string {
  if (missing(count)) return NONE;
  if (count < 1000) return `${count} B`;
  if (count < 1e6) return `${fixed(count / 1e3, 0)} kB`;
  return `${fixed(count / 1e6, 1)} MB`;
}

/** First eight digits of a hash: enough to tell versions apart on a screen. */
export const shortHash = (sha256: string | null | undefined) => sha256?.slice(0, 8) ?? NONE;

/** A sentence whose numbers keep their units on the same line. */
export const unbroken = (text: string) =>
  text.replace(/(?<=\d) (?=(?:%|m|mm|ms|s|min|h|d|m\/s|rad|kg|Hz|times)(?![\w/]))/g, "\u00a0");

/** Count with its noun: "1 throw", "12 throws". */
export const count = (value: number, noun: string) =>
  `${value.toLocaleString("en")} ${noun}${value === 1 ? "" : "s"}`;
