import { expect, it } from "vitest";
import type { Schema } from "../session/client";
import { neighboursOf } from "./Neighbours";

const page = (...ids: string[]) =>
  ({ rows: ids.map((throw_id) => ({ throw_id })) }) as unknown as Schema["ThrowPage"];

it.each([
  ["a", null, "b"],
  ["b", "a", "c"],
  ["c", "b", null],
  ["z", null, null],
])("beside %s stand %s and %s", (throwId, newer, older) =>
  expect(neighboursOf([undefined, page("x"), page("a", "b", "c")], throwId)).toEqual({
    newer,
    older,
  }),
);
