import { shortHash } from "./format";
import { Shortened } from "./Shortened";

/** A hash's first digits; a press shows it whole. */
export function Hash({ value, name }: { value: string | null | undefined; name: string }) {
  if (!value) return <>{shortHash(value)}</>;
  return <Shortened short={shortHash(value)} whole={value} name={name} />;
}
