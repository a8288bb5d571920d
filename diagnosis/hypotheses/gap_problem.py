"""One set of throws against one twin, linearised at "no effect"."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from diagnosis.healthy.filters import HealthyModel, nothing
from diagnosis.healthy.health import Health
from diagnosis.healthy.noise import NoiseModel
from diagnosis.hypotheses.prior_conflict import PriorShift, prior_shift
from diagnosis.inference.evidence import Information, screen, total
from diagnosis.linearisation.model_error import factors
from diagnosis.linearisation.parameters import ParameterLayout, beside
from diagnosis.linearisation.parameters import layout as layout_of
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
from diagnosis.population.model_misfit import filters_help, misfit, scaled_to
from diagnosis.population.other_machine_type import fitted_other_type_model, other_type_model
from diagnosis.tuning import CLEAR_LOG_POWER, PREVIEW_COUNT
from machine.calibration import ValveCalibration
from machine.conventions import ACTIVE_JOINTS, Array
from sim_twin.twin.profile import TwinProfile

TYPE_ADAPTATIONS = ((1.0, CLEAR_LOG_POWER),)
"""Adaptations to the misfit, in order: least factor, and log power from which the misfit is significant.
Machines of the type are never much closer to their twin than the others."""
OTHER_TYPE_ADAPTATIONS = ((0.0, 0.0), (1.0, 0.0))
"""Adaptations of a machine of another type: twice, since a factor scales the discrepancy and not the
noise beside it."""
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
    """Linearise at "no effect", with the model of healthy machines adapted to this machine."""
    of_type = health.noise
    layout = beside(layout, profile.effects)
    linear = linearise(prepared, profile, calibration, health.filters)
    is_other_type = not health.is_own and not filters_help(prepared, linear, health.filters)
    if is_other_type:
        other = other_type_model(of_type, (1.0,) * len(ACTIVE_JOINTS))
        health = health._replace(filters=nothing(), noise=other)
        layout = beside(layout_of(other), profile.effects)
        linear = linearise(prepared, profile, calibration, health.filters)
    found = _whitened(prepared, profile, calibration, health, layout, linear)
    previews = OTHER_TYPE_ADAPTATIONS if is_other_type else TYPE_ADAPTATIONS
    for least_ratio, clear_log_power in () if health.is_own else previews:
        excess = misfit(found.whitened, layout.priors, health.noise, clear_log_power)
        excess = {stage: max(factor, least_ratio) for stage, factor in excess.items()}
        if any(factor != 1.0 for factor in excess.values()):
            health = health._replace(noise=scaled_to(health.noise, excess))
            found = _whitened(prepared, profile, calibration, health, layout, linear)
    if is_other_type:
        near = fitted_other_type_model(of_type, total(found.information))
        model = near.model_copy(update={"channels": health.noise.channels})
        # The whitening does not depend on the machines' scatter.
        found = replace(found, model=model, layout=beside(layout_of(model), profile.effects))
    none = screen(total(found.information), found.layout.priors)
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
