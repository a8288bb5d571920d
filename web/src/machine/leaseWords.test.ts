import { expect, it } from "vitest";
import type { Schema } from "../session/client";
import { leaseWords } from "./leaseWords";

const lease = (holder: string | null) =>
  ({ holder, idle_release_utc: null }) as unknown as Schema["LeaseView"];

it.each([
  [null, false, "Nobody in control"],
  ["anna", true, "You are in control"],
  ["bert", false, "In control: bert"],
  ["anna", false, "In control: you, elsewhere"],
])("holder %s, ours %s: %s", (holder, isHolder, words) =>
  expect(leaseWords(lease(holder), isHolder, 0, "anna")).toBe(words),
);
