import type { Schema } from "../session/client";
import { age } from "../words/format";

const IDLE_WARNING_S = 60;

/** Whether the holder, which is not this session, is the same person signed in elsewhere. */
export const isOwnName = (lease: Schema["LeaseView"], username: string) =>
  username !== "" && lease.holder === username;

/**
 * "You are in control", "In control: anna", "Nobody in control"; a second sign-in of the same person is
 * somebody else: "In control: you, elsewhere".
 */
export function leaseWords(
  lease: Schema["LeaseView"],
  isHolder: boolean,
  nowMs: number,
  username: string,
): string {
  if (!lease.holder) return "Nobody in control";
  if (!isHolder)
    return `In control: ${isOwnName(lease, username) ? "you, elsewhere" : lease.holder}`;
  const idle_s = lease.idle_release_utc
    ? (Date.parse(lease.idle_release_utc) - nowMs) / 1000
    : null;
  if (idle_s !== null && idle_s < IDLE_WARNING_S)
    return `Control ends in ${age(idle_s)} without activity`;
  return "You are in control";
}
