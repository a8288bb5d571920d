"""Where to throw the next loads: beam search over target and grab volume, three loads deep.

The cost of a surface is the integral of its squared distance from the wanted one over the goal's region, plus
a weight for spilled volume. Loads are predicted by their means (`bulk.predicted_loads`); a plan is made
again after every load, from the surface that is there.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import shapely

from bulk.goal import Goal, candidate_cells, part_missing_m3, part_name
from bulk.height_field import HeightField
from bulk.predicted_loads import Prediction, make_candidates
from bulk.throw_model import ThrowModel
from machine.conventions import Array, BoolArray, IntArray
from machine.errors import UsageError
from machine.site.zones import Zone

DEPTH = 3
BEAM_COUNT = 6
CANDIDATE_COUNT = 200
"""Places times volumes."""
VOLUME_RATIOS = (1.0, 0.5)
"""Grab volumes that are compared, as shares of a full grab."""
SPILL_WEIGHT_M = 6.0
"""Cost of spilled volume, m3 m per m3: a spilled load costs as much as one that misses the wanted surface by
3 m everywhere. `benchmarks/bulk_jobs.py` measures what follows from it."""
ZONE_MARGIN_M = 0.5
ZONE_SIGMAS = 3.0
PASSED_OVER_M = 0.4
"""Places nearer than this to one that is passed over are passed over too: half the foot of a usual grab."""


class PlannedLoad(NamedTuple):
    """One load of a plan."""

    x_m: float
    y_m: float
    z_m: float
    """Surface at the target, frame `machine`."""
    volume_m3: float
    spill_ratio: float
    """Share of its volume that is expected outside of the goal."""
    missing_m3: float
    """In the ninth of the goal in which the target lies, before the load."""
    part: str
    cost: float
    """Expected change of the surface's cost, m3 m; negative: better."""

    @property
    def sentence(self) -> str:
        """Why this load."""
        return (
            f"{self.part}: {self.missing_m3:.2f} m3 missing; {self.volume_m3:.2f} m3 to "
            f"x {self.x_m:.1f} m, y {self.y_m:.1f} m; spill risk {100.0 * self.spill_ratio:.1f} %"
        )


class _Step(NamedTuple):
    before_m: Array
    """(rows, columns) surface before the load."""
    place: int
    volume_m3: float
    spill_ratio: float
    cost: float


class _Node(NamedTuple):
    height_m: Array
    cost: float
    steps: tuple[_Step, ...]


class LoadPlanner:
    """Plans the loads of one job."""

    def __init__(
        self,
        goal: Goal,
        field: HeightField,
        throws: ThrowModel,
        grab_m3: float,
        zones: Sequence[Zone] = (),
        *,
        depth: int = DEPTH,
        candidate_count: int = CANDIDATE_COUNT,
    ) -> None:
        """Prepare the candidates.

        Args:
            goal: of the job.
            field: the surface at the start.
            throws: reach, scatter and footprints.
            grab_m3: volume of a full grab.
            zones: exclusion zones, in which no target lies and over which no load flies.
            depth: loads looked ahead.
            candidate_count: places times volumes.

        Raises:
            UsageError: no place of the goal can be thrown at, with the numbers.
        """
        self.goal, self._throws, self._depth, self._grab_m3 = goal, throws, depth, grab_m3
        self._start, self._grid, self._zones = field, field.grid, tuple(zones)
        place_count = max(1, candidate_count // len(VOLUME_RATIOS))
        row, column = candidate_cells(goal, field, place_count)
        x_m, y_m = field.grid.x_m[column], field.grid.y_m[row]
        covariance = throws.covariance_m2(x_m, y_m)
        is_free = _free_of_zones(x_m, y_m, covariance, zones)
        height = goal.wanted_m[row, column]
        name = f"the {goal.kind.value}"
        least_m3 = grab_m3 * min(VOLUME_RATIOS)
        _refuse_unreachable(name, throws, np.hypot(x_m, y_m), height, is_free, least_m3)
        self._row, self._column = row[is_free], column[is_free]
        self._x_m, self._y_m = x_m[is_free], y_m[is_free]
        self._range_m = np.hypot(self._x_m, self._y_m)
        self._prediction = self._predict((self._row, self._column), covariance[is_free])

    def _predict(self, cells: tuple[IntArray, IntArray], covariance_m2: Array) -> Prediction:
        slope, largest_m3 = self._throws.material.slope_ratio, self._grab_m3
        among = make_candidates(self.goal, self._start, cells, covariance_m2, slope, largest_m3)
        return Prediction(self.goal, self._start, among, SPILL_WEIGHT_M)

    @property
    def places_m(self) -> Array:
        """(N, 2) candidate targets."""
        return np.stack([self._x_m, self._y_m], axis=-1)

    def reachable(self, height_m: Array, volume_m3: float) -> BoolArray:
        """(N) which candidates can be thrown at with a volume on a surface."""
        height = height_m[self._row, self._column]
        return self._throws.reachable(self._range_m, height, volume_m3)

    def next_loads(
        self, field: HeightField, passed_m: Sequence[tuple[float, float]] = ()
    ) -> tuple[PlannedLoad, ...]:
        """The best next loads, at most as many as the search is deep; none where all make it worse.

        Args:
            field: the surface that is there.
            passed_m: places that are passed over, with what is near them.
        """
        beam = [_Node(field.height_m, 0.0, ())]
        best = beam[0]
        allowed = np.ones(self._x_m.shape, dtype=np.bool_)
        for x_m, y_m in passed_m:
            allowed &= np.hypot(self._x_m - x_m, self._y_m - y_m) > PASSED_OVER_M
        for _ in range(self._depth):
            children = [child for node in beam for child in self._children(node, allowed)]
            beam = _distinct(children)
            if not beam:
                break
            best = min([best, *beam], key=lambda node: node.cost)
        return tuple(self._load(step) for step in best.steps)

    def load_at(self, field: HeightField, x_m: float, y_m: float, volume_m3: float) -> PlannedLoad:
        """A load at a place that a person chose.

        Raises:
            UsageError: beside the goal, out of reach, or in or behind a zone; with the numbers.
        """
        row, column = self._grid.cell_of(x_m, y_m)
        if not self._grid.holds(x_m, y_m) or not self.goal.region[row, column]:
            raise UsageError(
                f"x {x_m:.2f} m, y {y_m:.2f} m lies beside the {self.goal.kind.value}; choose a place on it"
            )
        x, y = np.array([x_m]), np.array([y_m])
        covariance = self._throws.covariance_m2(x, y)
        is_free = _free_of_zones(x, y, covariance, self._zones)
        height = np.array([field.height_m[row, column]])
        if not is_free.any():
            raise UsageError(
                f"x {x_m:.2f} m, y {y_m:.2f} m lies in an exclusion zone, behind one, or within "
                f"{ZONE_MARGIN_M:.1f} m and 3 standard deviations of it; choose another place"
            )
        _refuse_unreachable("the place", self._throws, np.hypot(x, y), height, is_free, volume_m3)
        prediction = self._predict((np.array([row]), np.array([column])), covariance)
        effects = prediction.effects(field.height_m, np.array([volume_m3]))
        return PlannedLoad(
            x_m=x_m,
            y_m=y_m,
            z_m=float(height[0]),
            volume_m3=volume_m3,
            spill_ratio=float(effects.spill_ratio[0, 0]),
            missing_m3=part_missing_m3(self.goal, self._grid, field.height_m, x_m, y_m),
            part=part_name(self.goal, x_m, y_m),
            cost=float(effects.cost[0, 0]),
        )

    def _children(self, node: _Node, allowed: BoolArray) -> list[_Node]:
        """A node's best loads that improve it, at places that are allowed (N)."""
        volumes = self._grab_m3 * np.asarray(VOLUME_RATIOS)
        effects = self._prediction.effects(node.height_m, volumes)
        able = [self.reachable(node.height_m, volume) for volume in volumes.tolist()]
        possible = allowed[:, None] & np.stack(able, axis=-1)
        cost = np.where(possible, effects.cost, np.inf)
        found: list[_Node] = []
        for index in np.argsort(cost, axis=None)[:BEAM_COUNT].tolist():
            place, volume = divmod(index, len(volumes))
            gain = float(cost[place, volume])
            if gain >= 0.0:
                break
            spill = float(effects.spill_ratio[place, volume])
            step = _Step(node.height_m, place, float(volumes[volume]), spill, gain)
            surface = self._prediction.after(node.height_m, effects, place, volume)
            found.append(_Node(surface, node.cost + gain, (*node.steps, step)))
        return found

    def _load(self, step: _Step) -> PlannedLoad:
        x_m, y_m = float(self._x_m[step.place]), float(self._y_m[step.place])
        return PlannedLoad(
            x_m=x_m,
            y_m=y_m,
            z_m=float(step.before_m[self._row[step.place], self._column[step.place]]),
            volume_m3=step.volume_m3,
            spill_ratio=step.spill_ratio,
            missing_m3=part_missing_m3(self.goal, self._grid, step.before_m, x_m, y_m),
            part=part_name(self.goal, x_m, y_m),
            cost=step.cost,
        )


def _distinct(nodes: list[_Node]) -> list[_Node]:
    """The best nodes; the same loads in another order lead to nearly the same surface and cost."""
    kept: dict[tuple[tuple[int, float], ...], _Node] = {}
    for node in sorted(nodes, key=lambda item: item.cost):
        kept.setdefault(tuple(sorted((step.place, step.volume_m3) for step in node.steps)), node)
        if len(kept) == BEAM_COUNT:
            break
    return list(kept.values())


def _free_of_zones(
    x_m: Array, y_m: Array, covariance_m2: Array, zones: Sequence[Zone]
) -> BoolArray:
    """Which targets keep a margin from every zone, on the ground and along the line of flight."""
    free = np.ones(x_m.shape, dtype=np.bool_)
    if not zones:
        return free
    spread = np.sqrt(np.linalg.eigvalsh(covariance_m2)[:, -1])
    lines = shapely.linestrings([[(0.0, 0.0), point] for point in zip(x_m, y_m, strict=True)])
    for zone in zones:
        gap = shapely.distance(shapely.Polygon(zone.corners_m), lines)
        free &= gap > ZONE_MARGIN_M + ZONE_SIGMAS * spread
    return free


def _refuse_unreachable(
    name: str, throws: ThrowModel, range_m: Array, height_m: Array, is_free: BoolArray,
    volume_m3: float,
) -> None:  # fmt: skip
    card = throws.card
    if not is_free.any():
        raise UsageError(
            f"every place of {name} lies in an exclusion zone, behind one, or within "
            f"{ZONE_MARGIN_M:.1f} m and 3 standard deviations of it; move the goal or the zone"
        )
    can = throws.reachable(range_m, height_m, volume_m3)
    if not (can & is_free).any():
        level = float(np.median(height_m))
        farthest = throws.farthest_m(level, volume_m3)
        load_kg = throws.material.mass_kg(volume_m3)
        if throws.reachable(range_m, height_m, 0.0).any():
            far = f"{farthest:.1f} m far" if farthest >= throws.nearest_m else "no target"
            raise UsageError(
                f"{name} lies {range_m.min():.1f} to {range_m.max():.1f} m from the slew axis; with "
                f"{load_kg:.0f} kg of {throws.material.name} {card.policy_id} reaches {far} there. "
                "Take smaller grabs, or move the goal or the machine"
            )
        raise UsageError(
            f"{name} lies {range_m.min():.1f} to {range_m.max():.1f} m from the slew axis "
            f"at heights up to {height_m.max():.2f} m; {card.policy_id} throws {throws.nearest_m:.1f} to "
            f"{farthest:.1f} m far there, at heights of {card.target_height_min_m:.1f} to "
            f"{card.target_height_max_m:.1f} m. Move the goal or the machine"
        )
