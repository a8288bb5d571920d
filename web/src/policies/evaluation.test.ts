import { describe, expect, it } from "vitest";
import { readEvaluations } from "./evaluation";

const row = { range_m: 9, throws: 200, landed: 199, success_ratio: 0.995, sd_downrange_m: 0.05 };

describe("evaluations on a card", () => {
  it("are read from campaigns and from training", () => {
    const read = readEvaluations([
      { plant: "virtual", unit_seed: 3, is_registered: true, targets: [row] },
      { plant: "training", throws: [{ range_m: 8, throw_count: 50, landed_count: 49 }] },
      { plant: "their.plant:Plant", unit_seed: 0, is_registered: false, targets: [row] },
    ]);
    expect(read.map((evaluation) => evaluation.where)).toEqual([
      "virtual machine, unit 3, registered",
      "training simulator",
      "their.plant:Plant, unit 0",
    ]);
    expect(read[0]?.rows[0]).toMatchObject({ throw_count: 200, mean_downrange_error_m: null });
    expect(read[1]?.rows[0]).toMatchObject({ throw_count: 50, success_ratio: 0.98 });
  });

  it("survive cards that say something else", () => {
    expect(readEvaluations([])).toEqual([]);
    expect(readEvaluations([null, 7, { plant: "x" }, { targets: [{ metres: 9 }] }])).toEqual([]);
    expect(readEvaluations([{ targets: [row, "?"] }])[0]?.rows).toHaveLength(1);
  });

  it("keep heights apart; cards of before have the ground alone", () => {
    const rows = readEvaluations([{ targets: [row, { ...row, height_m: 2 }] }])[0]?.rows;
    expect(rows?.map((read) => read.height_m)).toEqual([0, 2]);
  });
});
