/** What a new job can be here, from what stands around the machine; and goals in words. */

import { REACH_WITH_LOAD } from "../api/vocabulary";
import { azimuthOf, rangeOf, type SiteObject, topOf } from "../site/objects";
import { bearingWords, fixed, metres, percent, signed } from "../words/format";
import type { JobFile } from "./job";
import { cornersOf, type Rectangle } from "./rectangle";

export type GoalKind = "truck" | "pit" | "pile" | "trench" | "clear";
export type GoalChoice = { value: string; label: string; kind: GoalKind; item: SiteObject | null };

/** What a person types; sizes that the goal does not have are ignored. */
export type JobForm = {
  name: string;
  goal: string;
  /** Null: the planner chooses for each load. */
  mode: "2d" | "3d" | null;
  material: string;
  grab_m3: number;
  wall_m: number;
  fill_percent: number;
  top_m: number;
  range_m: number;
  azimuth_deg: number;
  length_m: number;
  width_m: number;
  height_m: number;
};

const DEGREES = 180 / Math.PI;
const AREA_MARGIN_M = 3;
const CELL_M = 0.1;
const FAR_M = 60;
const FIRST_WALL_M = 0.6;
/** The site names a bed's outside, a container its inside. */
const WALL_THICKNESS_M = 0.1;
const LEAST_INSIDE_M = 0.3;

/**
 * Boxes can be filled as truck beds, pits can be filled; a pile can stand anywhere. Trenches and heaps that
 * the site does not describe need a survey that holds them.
 */
export function goalChoices(objects: readonly SiteObject[], hasSurvey: boolean): GoalChoice[] {
  const of = (kind: "box" | "pit", goal: GoalKind, verb: string) =>
    objects
      .filter((item) => item.kind === kind)
      .map((item) => ({
        value: `${goal}:${item.name}`,
        label: `${verb} ${item.name}, ${metres(rangeOf(item), 1)}, ${bearingWords(azimuthOf(item))}`,
        kind: goal,
        item,
      }));
  const free = (kind: "pile" | "trench", label: string) => ({
    value: kind,
    label,
    kind,
    item: null,
  });
  return [
    ...of("box", "truck", "Fill"),
    ...of("pit", "pit", "Fill"),
    free("pile", "Build a pile at a place"),
    ...(hasSurvey
      ? [free("trench", "Fill a trench at a place"), ...of("box", "clear", "Clear a heap into")]
      : []),
  ];
}

/** Whether a goal fills a bed up to its walls. */
export const fillsBed = (kind: GoalKind) => kind === "truck" || kind === "clear";

type Reach = { mode: "2d" | "3d"; range_max_m: number };

/** Share of a policy's reach that a load is thrown to; null beyond the masses that were thrown. */
export function loadReachRatio(mode: "2d" | "3d", load_kg: number): number | null {
  const table = REACH_WITH_LOAD[mode];
  const next = table.findIndex(([mass_kg]) => mass_kg >= load_kg);
  const [above, below] = [table[next], table[next - 1]];
  if (!above) return null;
  if (!below) return above[1];
  const part = (load_kg - below[0]) / (above[0] - below[0]);
  return below[1] + part * (above[1] - below[1]);
}

/** "With 380 kg it reaches 9.25 m on the ground." */
export function loadReachWords(reach: Reach, load_kg: number): string {
  const share = loadReachRatio(reach.mode, load_kg);
  const load = `With ${fixed(load_kg, 0)} kg`;
  if (share === null) return `${load} nothing is thrown: take a smaller grab.`;
  return `${load} it reaches ${metres(share * reach.range_max_m)} on the ground.`;
}

/** What the dialog opens with, and what it takes on where another goal is chosen. */
export function firstForm(
  choice: GoalChoice,
  at: { range_m: number; azimuth_rad: number } | null,
): JobForm {
  return {
    name: choice.item?.name ?? choice.kind,
    goal: choice.value,
    mode: null,
    material: "gravel",
    grab_m3: 0.25,
    wall_m: FIRST_WALL_M,
    fill_percent: 95,
    top_m: 0,
    range_m: Number((at?.range_m ?? 8).toFixed(2)),
    azimuth_deg: Number(((at?.azimuth_rad ?? 0) * DEGREES).toFixed(1)),
    length_m: 4,
    width_m: 4,
    height_m: 1,
  };
}

/** The job as the server takes it; a survey stands for the level ground. Objects and zones are the site's. */
export function jobFile(form: JobForm, choice: GoalChoice, survey: string | null): JobFile {
  const place = typedPlace(form);
  const bed = choice.item ? insideOf(choice.item, choice.kind) : place;
  const common = {
    name: form.name.trim(),
    mode: form.mode,
    material: form.material,
    grab_m3: form.grab_m3,
    cell_m: CELL_M,
    containers: [],
    objects: [],
    zones: [],
    landing: [],
    ...(survey === null ? { area: areaAround(bed) } : { survey }),
  };
  if (choice.kind === "pile")
    return { ...common, work: { kind: "pile", foot: place, height_m: form.height_m } };
  if (choice.kind === "pit" || choice.kind === "trench")
    return { ...common, work: { kind: "trench", place: bed, top_m: form.top_m } };
  const name = choice.item?.name ?? "";
  const fill = { container: name, fill_ratio: form.fill_percent / 100 };
  const containers = [
    { name, ...bed, floor_m: choice.item ? topOf(choice.item) : 0, wall_m: form.wall_m },
  ];
  return choice.kind === "clear"
    ? { ...common, containers, loose: place, work: { kind: "clear", heap: place, ...fill } }
    : { ...common, containers, work: { kind: "truck", ...fill } };
}

function insideOf(item: SiteObject, kind: GoalKind) {
  const { x_m, y_m, turn_rad = 0 } = item;
  const walls_m = fillsBed(kind) ? 2 * WALL_THICKNESS_M : 0;
  const inside = (side_m: number) => Math.max(LEAST_INSIDE_M, round(side_m - walls_m));
  return { x_m, y_m, turn_rad, length_m: inside(item.length_m), width_m: inside(item.width_m) };
}

function typedPlace(form: JobForm) {
  const azimuth = form.azimuth_deg / DEGREES;
  return {
    x_m: round(form.range_m * Math.cos(azimuth)),
    y_m: round(form.range_m * Math.sin(azimuth)),
    length_m: form.length_m,
    width_m: form.width_m,
    turn_rad: azimuth,
  };
}

/** Level ground with room for what misses. */
function areaAround(place: Rectangle) {
  const corners = cornersOf(place);
  const side = (axis: 0 | 1, sign: 1 | -1) => {
    const outermost = sign * Math.max(...corners.map((corner) => sign * corner[axis]));
    const at = Math.round((outermost + sign * AREA_MARGIN_M) / CELL_M) * CELL_M;
    return round(Math.min(Math.max(at, -FAR_M), FAR_M));
  };
  return { x_min_m: side(0, -1), x_max_m: side(0, 1), y_min_m: side(1, -1), y_max_m: side(1, 1) };
}

const round = (value: number) => Number(value.toFixed(3));

/** Where a job's goal lies. */
export function goalPlace(file: JobFile): Rectangle | null {
  const { work } = file;
  if (work.kind === "pile") return work.foot;
  if (work.kind === "trench") return work.place;
  return file.containers?.find((item) => item.name === work.container) ?? null;
}

/** Where the material of a job is dug; null: it comes from elsewhere. */
export const heapOf = ({ work }: JobFile): Rectangle | null =>
  work.kind === "clear" ? work.heap : null;

/** "Fill truck bed to 95 % of its walls, 1.20 to 1.80 m". */
export function goalWords(file: JobFile): string {
  const { work } = file;
  if (work.kind === "pile") {
    const { foot, height_m } = work;
    return `Pile of ${fixed(foot.length_m, 1)} × ${metres(foot.width_m, 1)}, ${metres(height_m)} high, ${whereWords(foot)}`;
  }
  if (work.kind === "trench") {
    return `Fill level to ${signed(work.top_m ?? 0)} m, ${whereWords(work.place)}`;
  }
  const bed = goalPlace(file) as { floor_m?: number; wall_m?: number } | null;
  const walls =
    bed?.floor_m === undefined
      ? ""
      : ` of its walls, ${fixed(bed.floor_m)} to ${metres(bed.floor_m + (bed.wall_m ?? 0))}`;
  const filled = `${work.container} to ${percent(work.fill_ratio ?? 0.95)}${walls}`;
  return work.kind === "clear" ? `Clear a heap into ${filled}` : `Fill ${filled}`;
}

export function whereWords({ x_m, y_m }: { x_m: number; y_m: number }): string {
  return `${metres(Math.hypot(x_m, y_m), 1)} away, ${bearingWords(Math.atan2(y_m, x_m))}`;
}
