import { describe, expect, it } from "vitest";
import { readEvaluations } from "./evaluation";

const row = { range_m: 9, throws: 200, landed: 199, success_ratio: 0.995, sd_downrange_m: 0.05 };

describe("evaluations on a card", () => {
  it("are read from campaigns and from training", () => {
    const read = readEvaluations([
      { plant: "virtual", targets: [row] },
      { plant: "training", throws: [{ range_m: 8, throw_count: 50 }] },
    ]);
    expect(read.map((evaluation) => evaluation.plant)).toEqual(["virtual", "training"]);
    expect(read[0]?.rows[0]).toMatchObject({ throw_count: 200, mean_downrange_error_m: null });
    expect(read[1]?.rows[0]?.throw_count).toBe(50);
  });

  it("survive cards that say something else", () => {
    expect(readEvaluations([])).toEqual([]);
    expect(readEvaluations([null, 7, { plant: "x" }, { targets: [{ metres: 9 }] }])).toEqual([]);
    expect(readEvaluations([{ targets: [row, "?"] }])[0]?.rows).toHaveLength(1);
  });
});
