import { expect, test } from "vitest";
import type { Throw } from "../session/live";
import { found } from "./find";

const row = (throw_id: string, operator: string, range_m: number) =>
  ({
    throw_id,
    operator,
    machine_id: "m001",
    mode: "2d",
    phase: "ended",
    outcome: "landed",
    policy_id: "m545-2d-v7",
    created_utc: "2026-11-21T04:03:09Z",
    target: { range_m, azimuth_rad: 0, x_m: range_m, y_m: 0, z_m: 0 },
  }) as unknown as Throw;

const rows = [row("a1", "anna", 9), row("b2", "ben", 8.5)];

test("every word must stand in the row, in any order and case", () => {
  expect(found(rows, "")).toHaveLength(2);
  expect(found(rows, "M001 anna").map((one) => one.throw_id)).toEqual(["a1"]);
  expect(found(rows, "8.50 BEN").map((one) => one.throw_id)).toEqual(["b2"]);
  expect(found(rows, "anna 8.50")).toEqual([]);
  expect(found(rows, "b2")).toHaveLength(1);
});
