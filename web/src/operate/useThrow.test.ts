import { expect, test } from "vitest";
import type { Throw } from "../session/live";
import { newest } from "./useThrow";

const row = (phase: Throw["phase"]) => ({ phase }) as Throw;

test("an end that no event brought counts when it is asked for", () => {
  const asked = row("ended");
  expect(newest(null, asked)).toBe(asked);
  expect(newest(row("committed"), asked)).toBe(asked);
});

test("events are newer than an answer that has no end", () => {
  const received = row("committed");
  expect(newest(received, row("accepted"))).toBe(received);
  const ended = row("ended");
  expect(newest(ended, row("ended"))).toBe(ended);
});
