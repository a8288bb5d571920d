"""Two versions side by side: by the throws of validations, and by real throws of the history."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from sqlalchemy import select

from evaluation.validation.results import VersionResult
from evaluation.validation.validation import ValidationResult
from machine.errors import UsageError
from server.errors import ConflictError
from server.plans.policy_store import PolicyStore
from server.schemas.history import GroupBy, Outcome, PolicyView
from server.schemas.validation import (
    ComparisonSource,
    ComparisonView,
    DifferenceView,
    PolicyComparisonView,
)
from server.store.database import Database
from server.store.models import Throw
from server.store.throw_filters import threw_a_ball
from server.throws.landing_statistics import RANGE_BIN_M, Measured, statistics_of
from server.validation.validation_store import ValidationStore
from sim_twin.throws.accuracy import AccuracyReport, TargetAccuracy
from sim_twin.throws.accuracy_comparison import compare_accuracy

RESULT_LIMIT: Final = 20
"""Newest validations of a version that are looked through."""
THROW_LIMIT: Final = 5000
"""Newest throws of each version."""
HEIGHT_BIN_M: Final = 0.5
FAILED: Final = (Outcome.ABORTED.value, Outcome.FAULT.value)
"""Ends that count against a version; a person's STOP does not."""

Place = tuple[float, float]
"""Range and height of a target, m."""


class _Landings(NamedTuple):
    """Throws of one version."""

    errors: Mapping[Place, list[tuple[float, float]]]
    """Downrange and crossrange errors of the throws that landed, m."""
    thrown: Mapping[Place, int]
    measured: Sequence[Measured]

    @property
    def throw_count(self) -> int:
        return sum(self.thrown.values())


class PolicyComparison:
    """Compares versions."""

    def __init__(
        self, database: Database, policies: PolicyStore, validations: ValidationStore
    ) -> None:
        self._database = database
        self._policies = policies
        self._validations = validations

    def compare(self, a_sha256: str, b_sha256: str) -> PolicyComparisonView:
        """Compare b with a.

        Raises:
            ApiError: a version that was never seen, twice the same, or two modes.
        """
        a, b = self._policies.view(a_sha256), self._policies.view(b_sha256)
        if a_sha256 == b_sha256:
            raise ConflictError("same_policy", "A version is not compared with itself.")
        if a.mode is not b.mode:
            raise ConflictError("other_mode", f"{a.policy_id} and {b.policy_id} differ in mode.")
        return PolicyComparisonView(
            a_sha256=a_sha256,
            a_policy_id=a.policy_id,
            b_sha256=b_sha256,
            b_policy_id=b.policy_id,
            mode=a.mode,
            comparisons=(self._by_validation(a, b), self._by_history(a, b)),
        )

    # Validations ----------------------------------------------------------------------------------------

    def _by_validation(self, a: PolicyView, b: PolicyView) -> ComparisonView:
        found = self._thrown_in_validations(a, b)
        if isinstance(found, str):
            return _nothing(ComparisonSource.VALIDATION, found)
        first, second = found
        seeds = {unit.unit_seed for unit in first.units} & {u.unit_seed for u in second.units}
        landings = [_of_validation(version, seeds, a) for version in found]
        is_registered = [
            all(unit.is_registered for unit in version.units if unit.unit_seed in seeds)
            for version in found
        ]
        machines = "1 virtual machine" if len(seeds) == 1 else f"{len(seeds)} virtual machines"
        counts = f"{landings[0].throw_count} and {landings[1].throw_count} throws"
        basis = f"{counts} with {machines} that both versions threw with."
        return _view(ComparisonSource.VALIDATION, basis, (a, b), landings, is_registered)

    def _thrown_in_validations(
        self, a: PolicyView, b: PolicyView
    ) -> tuple[VersionResult, VersionResult] | str:
        """Both versions of one validation, else of the newest one of each; or why there are none."""
        of_a = self._validations.results(a.policy_sha256, RESULT_LIMIT)
        of_b = self._validations.results(b.policy_sha256, RESULT_LIMIT)
        for name, results in ((a.policy_id, of_a), (b.policy_id, of_b)):
            if not results:
                return f"{name} has no finished validation."
        for result in of_a:
            first, second = _version(result, a), _version(result, b)
            if first is not None and second is not None:
                return first, second
        first, second = _version(of_a[0], a), _version(of_b[0], b)
        assert first is not None and second is not None
        return first, second

    # History --------------------------------------------------------------------------------------------

    def _by_history(self, a: PolicyView, b: PolicyView) -> ComparisonView:
        thrown = [self._throws(version.policy_sha256) for version in (a, b)]
        machines = [{measured.machine_id for measured, _, _ in rows} for rows in thrown]
        common = machines[0] & machines[1]
        if not common:
            basis = "No machine has throws with both versions."
            return _nothing(ComparisonSource.HISTORY, basis)
        landings = [
            _of_history([row for row in rows if row[0].machine_id in common]) for rows in thrown
        ]
        counts = f"{landings[0].throw_count} and {landings[1].throw_count} throws"
        shown = ", ".join(sorted(common)) if len(common) <= 4 else f"{len(common)} machines"
        basis = f"{counts} of {shown}, by target ranges of {RANGE_BIN_M:g} m."
        return _view(ComparisonSource.HISTORY, basis, (a, b), landings, [True, True])

    def _throws(self, policy_sha256: str) -> list[tuple[Measured, float, bool]]:
        """Newest throws that say something of the version: numbers, target height, and whether it landed."""
        is_measured = Throw.measured_downrange_error_m.is_not(None)
        wanted = (
            select(
                Throw.throw_id,
                Throw.machine_id,
                Throw.operator,
                Throw.mode,
                Throw.policy_id,
                Throw.policy_sha256,
                Throw.range_m,
                Throw.measured_downrange_error_m,
                Throw.measured_crossrange_error_m,
                Throw.predicted_downrange_error_m,
                Throw.predicted_crossrange_error_m,
                Throw.target_z_m,
                Throw.outcome,
            )
            .where(
                Throw.policy_sha256 == policy_sha256,
                threw_a_ball(),
                Throw.outcome.in_(FAILED) | ((Throw.outcome == Outcome.LANDED) & is_measured),
            )
            .order_by(Throw.throw_id.desc())
            .limit(THROW_LIMIT)
        )
        with self._database.read() as session:
            rows: list[Any] = list(session.execute(wanted))
        return [(Measured(*row[:-2]), row[-2], row[-1] == Outcome.LANDED.value) for row in rows]


def _version(result: ValidationResult, policy: PolicyView) -> VersionResult | None:
    """What a version threw in a validation."""
    versions = (result.candidate, result.active)
    return next(
        (v for v in versions if v is not None and v.policy_sha256 == policy.policy_sha256), None
    )


def _of_validation(version: VersionResult, seeds: set[int], policy: PolicyView) -> _Landings:
    errors: dict[Place, list[tuple[float, float]]] = defaultdict(list)
    thrown: dict[Place, int] = defaultdict(int)
    measured: list[Measured] = []
    for unit in (unit for unit in version.units if unit.unit_seed in seeds):
        for row in unit.targets:
            place = (row.range_m, 0.0)
            thrown[place] += row.throws
            landed = zip(row.downrange_error_m, row.crossrange_error_m, strict=True)
            for number, (down_m, cross_m) in enumerate(landed):
                errors[place].append((down_m, cross_m))
                measured.append(
                    Measured(
                        throw_id=f"{version.policy_sha256[:12]}-{unit.unit_seed}-{row.range_m:g}-{number}",
                        machine_id=f"virtual machine {unit.unit_seed}",
                        operator="",
                        mode=policy.mode.value,
                        policy_id=version.policy_id,
                        policy_sha256=version.policy_sha256,
                        range_m=row.range_m,
                        downrange_error_m=down_m,
                        crossrange_error_m=cross_m,
                        predicted_downrange_error_m=None,
                        predicted_crossrange_error_m=None,
                    )
                )
    return _Landings(errors, thrown, measured)


def _of_history(rows: Sequence[tuple[Measured, float, bool]]) -> _Landings:
    errors: dict[Place, list[tuple[float, float]]] = defaultdict(list)
    thrown: dict[Place, int] = defaultdict(int)
    for measured, height_m, is_landed in rows:
        place = (
            round(measured.range_m / RANGE_BIN_M) * RANGE_BIN_M,
            round(height_m / HEIGHT_BIN_M) * HEIGHT_BIN_M,
        )
        thrown[place] += 1
        if is_landed:
            errors[place].append((measured.downrange_error_m, measured.crossrange_error_m))
    return _Landings(errors, thrown, [measured for measured, _, landed in rows if landed])


def _view(
    source: ComparisonSource,
    basis: str,
    policies: tuple[PolicyView, PolicyView],
    landings: Sequence[_Landings],
    is_registered: Sequence[bool],
) -> ComparisonView:
    reports = [
        _report(policy, found, registered)
        for policy, found, registered in zip(policies, landings, is_registered, strict=True)
    ]
    try:
        differences = compare_accuracy(reports[0], reports[1])
    except UsageError as error:
        return _nothing(source, f"{basis} But {error}.")
    return ComparisonView(
        source=source,
        basis=basis,
        differences=tuple(
            DifferenceView(
                range_m=row.range_m,
                height_m=row.height_m,
                quantity=row.quantity,
                a=row.first,
                b=row.second,
                difference=row.difference,
                verdict=row.verdict,
                a_throw_count=row.counts[0],
                b_throw_count=row.counts[1],
            )
            for row in differences
        ),
        stats=statistics_of([row for found in landings for row in found.measured], GroupBy.POLICY),
    )


def _report(policy: PolicyView, found: _Landings, is_registered: bool) -> AccuracyReport:
    return AccuracyReport(
        mode=policy.mode.value,
        plant="",
        policy=policy.policy_id,
        is_registered=is_registered,
        seed=0,
        seconds=0.0,
        real_time_factor=0.0,
        targets=[
            _target(place, found.errors.get(place, []), thrown)
            for place, thrown in sorted(found.thrown.items())
        ],
    )


def _target(place: Place, errors: Sequence[tuple[float, float]], thrown: int) -> TargetAccuracy:
    landed = len(errors)
    values = np.array(errors).reshape(landed, 2)
    mean = values.mean(axis=0) if landed else None
    sd = values.std(axis=0, ddof=1) if landed > 1 else None
    return TargetAccuracy(
        range_m=place[0],
        height_m=place[1],
        throws=thrown,
        landed=landed,
        success_ratio=landed / thrown,
        mean_downrange_error_m=None if mean is None else float(mean[0]),
        sd_downrange_m=None if sd is None else float(sd[0]),
        mean_crossrange_error_m=None if mean is None else float(mean[1]),
        sd_crossrange_m=None if sd is None else float(sd[1]),
    )


def _nothing(source: ComparisonSource, basis: str) -> ComparisonView:
    return ComparisonView(source=source, basis=basis, differences=(), stats=None)
