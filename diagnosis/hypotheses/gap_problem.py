"""One set of throws against one twin, linearised at "no effect"."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from diagnosis.healthy.filters import HealthyModel, nothing
from diagnosis.healthy.health import Health
from diagnosis.healthy.noise import NoiseModel
from diagnosis.hypotheses.prior_conflict import PriorShift, prior_shift
from diagnosis.linearisation.information import Information, healthy_posterior, total
from diagnosis.linearisation.model_error import factors
from diagnosis.linearisation.parameters import ParameterLayout, beside
from diagnosis.linearisation.residual_power import levels
from diagnosis.linearisation.sensitivities import LinearThrow, linearise
from diagnosis.linearisation.whitening import (
    Whitened,
    beside_named,
    information,
    whiten_throw,
    with_projection_subtracted,
)
from diagnosis.loading.prepared import PreparedThrow
from diagnosis.population.machine_filters import filters_help
from diagnosis.tuning import PREVIEW_COUNT
from machine.calibration import ValveCalibration
from machine.conventions import Array
from sim_twin.twin.profile import TwinProfile

OF_THROWS = ("prepared", "factor", "linear", "whitened", "information")
"""Fields of a problem with an entry for every throw."""


@dataclass(frozen=True, slots=True)
class GapProblem:
    """One set of throws against one twin."""

    prepared: Sequence[PreparedThrow]
    profile: TwinProfile
    calibration: ValveCalibration
    healthy: HealthyModel
    model: NoiseModel
    is_own: bool
    """Whether the model was learned from throws of this machine."""
    layout: ParameterLayout
    factor: Sequence[Sequence[Array]]
    """Cholesky factors of the noise of every throw's blocks."""
    linear: Sequence[LinearThrow]
    """At "no effect"."""
    whitened: Sequence[Whitened]
    information: Sequence[Information]
    beside: Array
    """Projection of the unmodelled effects on the named slopes (`beside_named`)."""
    none_levels: Mapping[str, float]
    """Log residual power of every block without effect (`levels`)."""
    none_shift: Mapping[str, PriorShift]
    """How far the healthy parameters of every part are moved without effect."""

    def preview_subset(self) -> "GapProblem":
        """Every other throw of each mode, for a preview of many sets of which few are evaluated again."""
        modes = [p.throw.mode for p in self.prepared]
        by_mode = [[i for i, one in enumerate(modes) if one == mode] for mode in sorted(set(modes))]
        chosen = sorted(i for own in by_mode for i in own[::2])
        if len(chosen) < PREVIEW_COUNT:
            return self
        return replace(self, **{f: [getattr(self, f)[i] for i in chosen] for f in OF_THROWS})


def pose_problem(
    prepared: Sequence[PreparedThrow],
    profile: TwinProfile,
    calibration: ValveCalibration,
    health: Health,
    layout: ParameterLayout,
) -> GapProblem:
    """Linearise at "no effect", without the filters of the type for a machine that they do not help."""
    layout = beside(layout, profile.effects)
    linear = linearise(prepared, profile, calibration, health.filters)
    if not health.is_own and not filters_help(prepared, linear, health.filters):
        health = health._replace(filters=nothing())
        linear = linearise(prepared, profile, calibration, health.filters)
    found = _whitened(prepared, profile, calibration, health, layout, linear)
    none = healthy_posterior(total(found.information), found.layout.priors)
    shift = prior_shift(found.layout.priors.scatter, none.covariance, none.mean)
    level = levels(found.whitened, none.mean, found.model.dropped_ratio)
    return replace(found, none_levels=level, none_shift=shift)


def _whitened(
    prepared: Sequence[PreparedThrow],
    profile: TwinProfile,
    calibration: ValveCalibration,
    health: Health,
    layout: ParameterLayout,
    linear: Sequence[LinearThrow],
) -> GapProblem:
    model = health.noise
    factor = [factors(p, model) for p in prepared]
    raw = [
        whiten_throw(p, one, model, f) for p, one, f in zip(prepared, linear, factor, strict=True)
    ]
    beside = beside_named(total(information(raw)), layout)
    whitened = [with_projection_subtracted(one, beside, model) for one in raw]
    return GapProblem(
        prepared,
        profile,
        calibration,
        health.filters,
        model,
        health.is_own,
        layout,
        factor,
        linear,
        whitened,
        information(whitened),
        beside,
        {},
        {},
    )
