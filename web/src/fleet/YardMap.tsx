import { useState } from "react";
import { niceStep } from "../charts/scale";
import { useSize } from "../charts/useSize";
import { LampMark } from "../machine/LampMark";
import { lampWords } from "../machine/phase";
import type { Machine } from "../session/live";
import { useLive } from "../session/liveStore";
import { useNow } from "../session/useNow";
import { useMay } from "../session/useSession";
import { errorWords } from "../words/errors";
import { FleetTable } from "./FleetTable";
import { PlaceForm } from "./PlaceForm";
import type { FleetRow } from "./rows";
import { type MapMachine, useYardMap } from "./useFleet";
import classes from "./YardMap.module.css";
import {
  boxOf,
  footprint,
  labelPlaces,
  type Place,
  type PlanView,
  polygon,
  toYard,
  viewOf,
} from "./yardGeometry";

const BAR_PX = 120;
const MARK_M = 1.5;
/** The largest mark of a machine on the plan, two lines of text. */
const LABEL_PX = [208, 52] as const;

type Placed = { row: FleetRow; found: MapMachine; place: Place };

/** The yard from above: machines at their places, reach, objects, zones and last impacts. */
export function YardMap({ rows }: { rows: readonly FleetRow[] }) {
  const map = useYardMap();
  const sites = useLive((live) => live.sites);
  const zones = useLive((live) => live.zones);
  const [chosen, setChosen] = useState<string | null>(null);
  const mayPlace = useMay("machine.edit");
  if (map.isError) return <p className={classes.note}>{errorWords(map.error)}</p>;
  if (!map.data) return null;
  const found = new Map(
    map.data.map((one) => [
      one.machine_id,
      {
        ...one,
        // Changes since the page was opened come by themselves.
        objects: sites[one.machine_id]?.objects ?? one.objects,
        zones: zones[one.machine_id]?.approved ?? one.zones,
      },
    ]),
  );
  const placed: Placed[] = [];
  const unplaced: FleetRow[] = [];
  for (const row of rows) {
    const one = found.get(row.machine.machine_id);
    if (one?.place) placed.push({ row, found: one, place: one.place });
    else unplaced.push(row);
  }
  const selected = rows.find((row) => row.machine.machine_id === chosen);
  const mark = (row: FleetRow) => (
    <Mark
      key={row.machine.machine_id}
      row={row}
      isChosen={row === selected}
      onChoose={() => setChosen(row === selected ? null : row.machine.machine_id)}
    />
  );
  return (
    <section aria-label="Yard map" className={classes.map}>
      {placed.length > 0 && (
        <>
          <Plan placed={placed} mark={mark} />
          <p className={classes.note}>
            Rings: reach on the ground. Crosses: last impacts. Dashed areas: exclusion zones. A
            dashed machine has no link: what it shows is old.
          </p>
        </>
      )}
      {unplaced.length > 0 && (
        <fieldset className={classes.unplaced} aria-label="Without a place">
          <span>Without a place on the plan:</span>
          {unplaced.map(mark)}
        </fieldset>
      )}
      {!selected && (
        <p className={classes.note}>
          Choose a machine for its state, its STOP{mayPlace ? " and its place" : ""}.
        </p>
      )}
      {selected && <FleetTable rows={[selected]} />}
      {selected && mayPlace && (
        <PlaceForm
          key={selected.machine.machine_id}
          machineId={selected.machine.machine_id}
          place={found.get(selected.machine.machine_id)?.place ?? null}
        />
      )}
    </section>
  );
}

type PlanProps = { placed: readonly Placed[]; mark: (row: FleetRow) => React.ReactNode };

function Plan({ placed, mark }: PlanProps) {
  const { ref, width, height } = useSize<HTMLDivElement>();
  const box = boxOf(placed.flatMap(extent));
  const view = box && width > 0 ? viewOf(box, width, height) : null;
  const points = view
    ? placed.map(({ place }) => [view.x(place.x_m), view.y(place.y_m)] as const)
    : [];
  const labels = labelPlaces(points, [width, height], LABEL_PX);
  return (
    <div ref={ref} className={classes.plan}>
      {view && (
        <>
          <svg width={width} height={height} aria-hidden="true">
            {placed.map((one) => (
              <Ground key={one.found.machine_id} {...one} view={view} />
            ))}
            {points.map(([x, y], index) => (
              <path
                key={placed[index]?.found.machine_id}
                className={classes.leader}
                d={`M${x} ${y}L${labels[index]?.join(" ")}`}
              />
            ))}
            <Bar view={view} height={height} />
          </svg>
          {placed.map(({ row }, index) => (
            <div
              key={row.machine.machine_id}
              className={classes.at}
              style={{ left: labels[index]?.[0], top: labels[index]?.[1], maxWidth: LABEL_PX[0] }}
            >
              {mark(row)}
            </div>
          ))}
        </>
      )}
    </div>
  );
}

/** Circles that hold all that is drawn of a machine. */
function extent({ row, found, place }: Placed) {
  const points = [
    ...found.objects.flatMap(footprint),
    ...found.zones.flatMap((zone) => zone.corners_m),
    ...found.impacts.map(({ x_m, y_m }) => [x_m, y_m] as const),
  ];
  return [
    { at: [place.x_m, place.y_m] as const, radius_m: reachOf(row.machine) },
    ...points.map((point) => ({ at: toYard(place, point), radius_m: 0 })),
  ];
}

const reachOf = (machine: Machine) =>
  Math.max(machine.reach.static_reach_m, ...machine.reach.modes.map((mode) => mode.range_max_m));

const nearestOf = (machine: Machine) =>
  Math.min(...machine.reach.modes.map((mode) => mode.range_min_m));

function Ground({ row, found, place, view }: Placed & { view: PlanView }) {
  const { machine } = row;
  const [x, y] = [view.x(place.x_m), view.y(place.y_m)];
  const nearest_m = nearestOf(machine);
  const place_ = (points: readonly (readonly [number, number])[]) =>
    polygon(
      points.map((point) => toYard(place, point)),
      view,
    );
  return (
    <g data-lost={!machine.link.is_connected || undefined}>
      <circle className={classes.reach} cx={x} cy={y} r={reachOf(machine) * view.scale} />
      {Number.isFinite(nearest_m) && (
        <circle className={classes.nearest} cx={x} cy={y} r={nearest_m * view.scale} />
      )}
      {found.zones.map((zone) => (
        <polygon key={zone.name} className={classes.zone} points={place_(zone.corners_m)} />
      ))}
      {found.objects.map((object) => (
        <polygon
          key={object.name}
          className={classes.object}
          data-kind={object.kind}
          points={place_(footprint(object))}
        />
      ))}
      {found.impacts.map((impact, index) => {
        const [at_x, at_y] = toYard(place, [impact.x_m, impact.y_m]);
        return (
          <path
            key={impact.throw_id}
            className={classes.impact}
            data-newest={index === 0 || undefined}
            d={`M${view.x(at_x)} ${view.y(at_y)}m-4 -4l8 8m0 -8l-8 8`}
          />
        );
      })}
      <polygon
        className={classes.body}
        points={place_([
          [MARK_M, 0],
          [-MARK_M, MARK_M * 0.7],
          [-MARK_M, -MARK_M * 0.7],
        ])}
      />
    </g>
  );
}

function Bar({ view, height }: { view: PlanView; height: number }) {
  const step_m = niceStep(BAR_PX / view.scale);
  const length = step_m * view.scale;
  return (
    <>
      <path className={classes.bar} d={`M10 ${height - 10}h${length}m0 -4v8m${-length} 0v-8`} />
      <text className={classes.barText} x={16 + length} y={height - 6}>
        {step_m} m
      </text>
    </>
  );
}

type MarkProps = { row: FleetRow; isChosen: boolean; onChoose: () => void };

function Mark({ row: { machine, calling_count }, isChosen, onChoose }: MarkProps) {
  const words = lampWords(machine, useNow());
  const id = machine.machine_id;
  return (
    <button
      type="button"
      className={classes.mark}
      aria-pressed={isChosen}
      data-lost={!machine.link.is_connected || undefined}
      data-testid={`map-${id}`}
      onClick={onChoose}
    >
      <LampMark phase={machine.lamp} />
      <span>
        <strong>{machine.name || id}</strong> {words}
        {machine.is_stop_pending && " · STOP pending"}
        {calling_count > 0 && ` · ${calling_count} new`}
      </span>
    </button>
  );
}
