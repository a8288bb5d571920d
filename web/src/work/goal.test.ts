import { describe, expect, it } from "vitest";
import { ApiError } from "../session/client";
import type { SiteObject } from "../site/objects";
import { fieldOf } from "./fieldErrors";
import {
  firstForm,
  goalChoices,
  goalPlace,
  goalWords,
  jobFile,
  loadReachRatio,
  loadReachWords,
} from "./goal";

const object = (change: Partial<SiteObject>) =>
  ({ turn_rad: 0, base_height_m: 0, top_ratio: 0, ...change }) as SiteObject;
const BED = object({
  name: "truck bed",
  kind: "box",
  x_m: 7.4,
  y_m: 5.6,
  turn_rad: -0.92,
  length_m: 4.4,
  width_m: 2.4,
  height_m: 1.2,
});
const PIT = object({
  name: "pit",
  kind: "pit",
  x_m: 8.3,
  y_m: -3.2,
  length_m: 2.4,
  width_m: 2.4,
  height_m: 0.8,
});
function fileOf(value: string, survey: string | null = null) {
  const choice = goalChoices([BED, PIT], survey !== null).find((one) => one.value === value);
  if (!choice) throw new Error(`no goal ${value}`);
  return jobFile(firstForm(choice, null), choice, survey);
}

describe("a new job", () => {
  it("offers what the site has; trenches and heaps with a survey only", () => {
    const values = (hasSurvey: boolean) =>
      goalChoices([BED, PIT], hasSurvey).map((one) => one.value);
    expect(values(false)).toEqual(["truck:truck bed", "pit:pit", "pile"]);
    expect(values(true)).toEqual([...values(false), "trench", "clear:truck bed"]);
    expect(goalChoices([], false).map((one) => one.value)).toEqual(["pile"]);
    const names = goalChoices([BED], true).map((one) => firstForm(one, null).name);
    expect(names).toEqual(["truck bed", "pile", "trench", "truck bed"]);
  });

  it("fills the inside of a bed from its top to its walls, on ground around it", () => {
    const file = fileOf("truck:truck bed");
    expect(file.mode).toBeNull();
    expect(file.containers).toEqual([
      {
        name: "truck bed",
        x_m: 7.4,
        y_m: 5.6,
        turn_rad: -0.92,
        length_m: 4.2,
        width_m: 2.2,
        floor_m: 1.2,
        wall_m: 0.6,
      },
    ]);
    const { area } = file;
    expect(area && area.x_max_m - area.x_min_m).toBeGreaterThan(9);
    expect(area && area.x_min_m < 5 && area.y_min_m < 3 && area.y_max_m > 8).toBe(true);
  });

  it("fills a pit level, and digs a heap where the survey has one", () => {
    expect(fileOf("pit:pit").work).toMatchObject({ kind: "trench", top_m: 0 });
    const clear = fileOf("clear:truck bed", "yard.csv");
    expect(clear.survey).toBe("yard.csv");
    expect(clear.area).toBeUndefined();
    expect(clear.work).toMatchObject({ kind: "clear", container: "truck bed", heap: clear.loose });
  });
});

describe("a goal", () => {
  it("is put in words, with its place", () => {
    const bed = fileOf("truck:truck bed");
    expect(goalWords(bed)).toBe("Fill truck bed to 95 % of its walls, 1.20 to 1.80 m");
    expect(goalPlace(bed)).toMatchObject({ x_m: 7.4, length_m: 4.2 });
    expect(goalWords(fileOf("pit:pit"))).toBe("Fill level to 0.00 m, 8.9 m away, 21.1° right");
    expect(goalWords(fileOf("pile"))).toBe(
      "Pile of 4.0 × 4.0 m, 1.00 m high, 8.0 m away, 0.0° ahead",
    );
  });
});

describe("reach with a load", () => {
  it("falls with the mass, and ends with the masses that were thrown", () => {
    expect(loadReachRatio("2d", 0)).toBe(1);
    expect(loadReachRatio("2d", 475)).toBeCloseTo(0.9, 6);
    expect(loadReachRatio("2d", 5000)).toBeNull();
    const reach = { mode: "2d" as const, range_max_m: 10 };
    expect(loadReachWords(reach, 380)).toBe("With 380 kg it reaches 9.25 m on the ground.");
    expect(loadReachWords(reach, 5000)).toContain("take a smaller grab");
  });
});

describe("a refusal", () => {
  const refused = (status: number, detail: unknown) =>
    fieldOf(new ApiError(status, "invalid", "no", detail));

  it("stands beside its field, and beside the goal where it speaks of its place", () => {
    expect(refused(422, { problems: [{ field: "body.file.grab_m3" }] })).toBe("grab_m3");
    expect(refused(422, { problems: [{ field: "body.file.containers.0.wall_m" }] })).toBe("wall_m");
    expect(refused(422, { problems: [{ field: "survey" }] })).toBe("survey");
    expect(refused(422, null)).toBe("goal");
    expect(refused(409, null)).toBeNull();
    expect(fieldOf(new Error("no"))).toBeNull();
  });
});
