"""Where and how to throw the next loads: beam search over target and grab volume, three loads deep.

The cost of a surface is the integral of its squared distance from the wanted one over the goal's region, plus
a weight for spilled volume. Mode and pace are chosen for every place before the search: those by which a load
there improves the surface most in the time that it takes. Loads are predicted by their means
(`bulk.predicted_loads`); a plan is made again after every load, from the surface that is there.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import shapely

from bulk.goal import Goal, candidate_cells, part_missing_m3, part_name
from bulk.height_field import HeightField
from bulk.predicted_loads import Effects, Prediction, make_candidates
from bulk.throw_model import ThrowModel
from machine.conventions import Array, BoolArray, IntArray, Mode
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
GRAB_S = 20.0
"""Time of a load beside the throw itself: back, grab, lift; assumed."""
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
    mode: Mode
    pace_ratio: float
    others: str
    """What the same load would spill, and how much longer it would take, thrown otherwise; may be empty."""

    @property
    def sentence(self) -> str:
        """Why this load."""
        others = f" ({self.others})" if self.others else ""
        return (
            f"{self.part}: {self.missing_m3:.2f} m3 missing; {self.volume_m3:.2f} m3 to "
            f"x {self.x_m:.1f} m, y {self.y_m:.1f} m; {_way(self.mode, self.pace_ratio)}: "
            f"spill risk {100.0 * self.spill_ratio:.1f} %{others}"
        )


class _Choice(NamedTuple):
    """How each place (N) is thrown at in one search."""

    model: IntArray
    """(N) index of the throw model."""
    prediction: Prediction


class _Tried(NamedTuple):
    cost: float
    spill_ratio: float


class _Step(NamedTuple):
    before_m: Array
    """(rows, columns) surface before the load."""
    place: int
    model: int
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
        models: Sequence[ThrowModel],
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
            models: reach, scatter and footprints of every mode and pace that may be chosen; at least one.
            grab_m3: volume of a full grab.
            zones: exclusion zones, in which no target lies and over which no load flies.
            depth: loads looked ahead.
            candidate_count: places times volumes.

        Raises:
            UsageError: no place of the goal can be thrown at, with the numbers.
        """
        self.goal, self._models, self._depth, self._grab_m3 = goal, tuple(models), depth, grab_m3
        self._start, self._grid, self._zones = field, field.grid, tuple(zones)
        place_count = max(1, candidate_count // len(VOLUME_RATIOS))
        row, column = candidate_cells(goal, field, place_count)
        x_m, y_m = field.grid.x_m[column], field.grid.y_m[row]
        covariance, is_free = self._spread_at(x_m, y_m)
        height = goal.wanted_m[row, column]
        name = f"the {goal.kind.value}"
        least_m3 = grab_m3 * min(VOLUME_RATIOS)
        self._refuse_unreachable(name, np.hypot(x_m, y_m), height, is_free, least_m3)
        kept = is_free.any(axis=0)
        self._row, self._column = row[kept], column[kept]
        self._x_m, self._y_m = x_m[kept], y_m[kept]
        self._range_m = np.hypot(self._x_m, self._y_m)
        self._covariance_m2, self._is_free = covariance[:, kept], is_free[:, kept]
        self._predictions = [
            self._predict((self._row, self._column), one) for one in self._covariance_m2
        ]
        load_s = GRAB_S + np.array([model.release_s for model in self._models])
        self._speed_ratio = load_s.min() / load_s

    def _spread_at(self, x_m: Array, y_m: Array) -> tuple[Array, BoolArray]:
        """Covariances (K, N, 2, 2) of the K models about places (N), and which keep free of zones (K, N)."""
        covariance = np.stack([model.covariance_m2(x_m, y_m) for model in self._models])
        free = [_free_of_zones(x_m, y_m, one, self._zones) for one in covariance]
        return covariance, np.stack(free)

    def _predict(self, cells: tuple[IntArray, IntArray], covariance_m2: Array) -> Prediction:
        slope, largest_m3 = self._models[0].material.slope_ratio, self._grab_m3
        among = make_candidates(self.goal, self._start, cells, covariance_m2, slope, largest_m3)
        return Prediction(self.goal, self._start, among, SPILL_WEIGHT_M)

    @property
    def places_m(self) -> Array:
        """(N, 2) candidate targets."""
        return np.stack([self._x_m, self._y_m], axis=-1)

    def reachable(self, height_m: Array, volume_m3: float) -> BoolArray:
        """(N) which candidates can be thrown at with a volume on a surface, by any mode and pace."""
        return np.any(self._reached(height_m, volume_m3), axis=0)

    def _reached(self, height_m: Array, volume_m3: float) -> BoolArray:
        """(K, N) the same by every model."""
        height = height_m[self._row, self._column]
        can = [model.reachable(self._range_m, height, volume_m3) for model in self._models]
        return np.stack(can) & self._is_free

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
        choice = self._choose(field.height_m)
        for _ in range(self._depth):
            children = [child for node in beam for child in self._children(node, choice, allowed)]
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
        is_free = self._spread_at(np.array([x_m]), np.array([y_m]))[1]
        if not is_free.any():
            raise UsageError(
                f"x {x_m:.2f} m, y {y_m:.2f} m lies in an exclusion zone, behind one, or within "
                f"{ZONE_MARGIN_M:.1f} m and 3 standard deviations of it; choose another place"
            )
        height = field.height_m[row, column]
        range_m = np.array([np.hypot(x_m, y_m)])
        self._refuse_unreachable("the place", range_m, np.array([height]), is_free, volume_m3)
        tried = self._tried(field.height_m, x_m, y_m, volume_m3)
        best = self._best_of(tried)
        effect = tried[best]
        return self._described(
            field.height_m, (x_m, y_m), volume_m3, effect.spill_ratio, effect.cost, best
        )

    def _choose(self, height_m: Array) -> _Choice:
        """For every place the model by which a load improves a surface most in its time."""
        if len(self._models) == 1:
            return _Choice(np.zeros(len(self._x_m), dtype=np.int64), self._predictions[0])
        volumes = self._volumes_m3
        able = np.stack([self._reached(height_m, volume) for volume in volumes.tolist()], axis=-1)
        cost = np.stack([one.effects(height_m, volumes).cost for one in self._predictions])
        gain = np.where(able, cost * self._speed_ratio[:, None, None], np.inf).min(axis=2)
        model = gain.argmin(axis=0)
        covariance = self._covariance_m2[model, np.arange(len(model))]
        return _Choice(model, self._predict((self._row, self._column), covariance))

    @property
    def _volumes_m3(self) -> Array:
        return self._grab_m3 * np.asarray(VOLUME_RATIOS)

    def _children(self, node: _Node, choice: _Choice, allowed: BoolArray) -> list[_Node]:
        """A node's best loads that improve it, at places that are allowed (N)."""
        volumes, at = self._volumes_m3, np.arange(len(allowed))
        effects = choice.prediction.effects(node.height_m, volumes)
        able = [self._reached(node.height_m, one)[choice.model, at] for one in volumes.tolist()]
        possible = allowed[:, None] & np.stack(able, axis=-1)
        speed = self._speed_ratio[choice.model][:, None]
        gain = np.where(possible, effects.cost * speed, np.inf)
        found: list[_Node] = []
        for index in np.argsort(gain, axis=None)[:BEAM_COUNT].tolist():
            place, volume = divmod(index, len(volumes))
            if gain[place, volume] >= 0.0:
                break
            step = _step(node, choice, effects, place, volume, float(volumes[volume]))
            surface = choice.prediction.after(node.height_m, effects, place, volume)
            cost = node.cost + float(gain[place, volume])
            found.append(_Node(surface, cost, (*node.steps, step)))
        return found

    def _load(self, step: _Step) -> PlannedLoad:
        place_m = float(self._x_m[step.place]), float(self._y_m[step.place])
        return self._described(
            step.before_m, place_m, step.volume_m3, step.spill_ratio, step.cost, step.model
        )

    def _described(
        self, height_m: Array, place_m: tuple[float, float], volume_m3: float, spill_ratio: float,
        cost: float, model: int,
    ) -> PlannedLoad:  # fmt: skip
        """A load, with what is missing at its place and what other ways of throwing it would do."""
        x_m, y_m = place_m
        row, column = self._grid.cell_of(x_m, y_m)
        way = self._models[model]
        return PlannedLoad(
            x_m=x_m,
            y_m=y_m,
            z_m=float(height_m[row, column]),
            volume_m3=volume_m3,
            spill_ratio=spill_ratio,
            missing_m3=part_missing_m3(self.goal, self._grid, height_m, x_m, y_m),
            part=part_name(self.goal, x_m, y_m),
            cost=cost,
            mode=way.card.mode,
            pace_ratio=way.pace_ratio,
            others=self._others(height_m, place_m, volume_m3, model),
        )

    def _tried(
        self, height_m: Array, x_m: float, y_m: float, volume_m3: float
    ) -> dict[int, _Tried]:
        """Effect of one load by every model that reaches the place."""
        row, column = self._grid.cell_of(x_m, y_m)
        cell = np.array([row]), np.array([column])
        covariance, is_free = self._spread_at(np.array([x_m]), np.array([y_m]))
        range_m, height = np.array([np.hypot(x_m, y_m)]), height_m[row, column][None]
        found: dict[int, _Tried] = {}
        for index, model in enumerate(self._models):
            if is_free[index, 0] and model.reachable(range_m, height, volume_m3)[0]:
                effects = self._predict(cell, covariance[index]).effects(
                    height_m, np.array([volume_m3])
                )
                found[index] = _Tried(float(effects.cost[0, 0]), float(effects.spill_ratio[0, 0]))
        return found

    def _best_of(self, tried: Mapping[int, _Tried]) -> int:
        """The model that improves the surface most in its time; the least bad where all make it worse."""
        rates = {i: one.cost * self._speed_ratio[i] for i, one in tried.items()}
        if min(rates.values()) < 0.0:
            return min(rates, key=rates.__getitem__)
        # A slow load that harms is no better than a quick one.
        return min(tried, key=lambda index: tried[index].cost)

    def _others(
        self, height_m: Array, place_m: tuple[float, float], volume_m3: float, chosen: int
    ) -> str:
        """The best other pace of the same mode, and the best of every other mode, in words."""
        if len(self._models) == 1:
            return ""
        tried = self._tried(height_m, *place_m, volume_m3)
        words: list[str] = []
        own = self._models[chosen]
        for mode in sorted({model.card.mode for model in self._models}, key=own.card.mode.__ne__):
            of = [i for i, m in enumerate(self._models) if m.card.mode is mode and i != chosen]
            reached = [i for i in of if i in tried]
            if reached:
                best = self._best_of({i: tried[i] for i in reached})
                model = self._models[best]
                longer_s = model.release_s - own.release_s
                words.append(
                    f"{_way(mode, model.pace_ratio)}: {100.0 * tried[best].spill_ratio:.1f} %, "
                    f"{longer_s:+.1f} s"
                )
            elif of and mode is not own.card.mode:
                words.append(f"{mode.value.upper()} does not reach it")
        return "; ".join(words)

    def _refuse_unreachable(
        self, name: str, range_m: Array, height_m: Array, is_free: BoolArray, volume_m3: float
    ) -> None:
        """Refuse places (N) that no model reaches; is_free: (K, N)."""
        if not is_free.any():
            raise UsageError(
                f"every place of {name} lies in an exclusion zone, behind one, or within "
                f"{ZONE_MARGIN_M:.1f} m and 3 standard deviations of it; move the goal or the zone"
            )
        can = [model.reachable(range_m, height_m, volume_m3) for model in self._models]
        if (np.stack(can) & is_free).any():
            return
        level = float(np.median(height_m))
        model = max(self._models, key=lambda one: one.farthest_m(level, volume_m3))
        raise _unreachable(name, model, range_m, height_m, volume_m3)


def _way(mode: Mode, pace_ratio: float) -> str:
    return f"{mode.value.upper()} at pace {pace_ratio:g}"


def _step(
    node: _Node, choice: _Choice, effects: Effects, place: int, volume: int, volume_m3: float
) -> _Step:
    return _Step(
        before_m=node.height_m,
        place=place,
        model=int(choice.model[place]),
        volume_m3=volume_m3,
        spill_ratio=float(effects.spill_ratio[place, volume]),
        cost=float(effects.cost[place, volume]),
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


def _unreachable(
    name: str, model: ThrowModel, range_m: Array, height_m: Array, volume_m3: float
) -> UsageError:
    """Why places cannot be thrown at by the model that reaches farthest, with the numbers."""
    card = model.card
    level = float(np.median(height_m))
    farthest = model.farthest_m(level, volume_m3)
    load_kg = model.material.mass_kg(volume_m3)
    if model.reachable(range_m, height_m, 0.0).any():
        far = f"{farthest:.1f} m far" if farthest >= model.nearest_m else "no target"
        return UsageError(
            f"{name} lies {range_m.min():.1f} to {range_m.max():.1f} m from the slew axis; with "
            f"{load_kg:.0f} kg of {model.material.name} {card.policy_id} reaches {far} there. "
            "Take smaller grabs, or move the goal or the machine"
        )
    return UsageError(
        f"{name} lies {range_m.min():.1f} to {range_m.max():.1f} m from the slew axis "
        f"at heights up to {height_m.max():.2f} m; {card.policy_id} throws {model.nearest_m:.1f} to "
        f"{farthest:.1f} m far there, at heights of {card.target_height_min_m:.1f} to "
        f"{card.target_height_max_m:.1f} m. Move the goal or the machine"
    )
