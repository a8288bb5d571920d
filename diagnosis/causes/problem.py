"""One set of throws against one twin, linearised at "no effect"."""

from collections.abc import Sequence
from dataclasses import dataclass

from diagnosis.causes.parameters import Layout
from diagnosis.causes.parameters import layout as layout_of
from diagnosis.causes.residuals import Linear, linearise
from diagnosis.causes.selection import (
    Information,
)
from diagnosis.causes.whitening import (
    Basis,
    Whitened,
    factors,
    information,
    whiten_throw,
)
from diagnosis.healthy.adapt import filters_help, misfit, scaled_to, stranger
from diagnosis.healthy.filters import HealthyModel, nothing
from diagnosis.healthy.health import Health
from diagnosis.healthy.noise import NoiseModel
from diagnosis.loading.prepared import PreparedThrow
from machine.calibration import ValveCalibration
from machine.conventions import Array
from sim_twin.twin.profile import TwinProfile


@dataclass(frozen=True, slots=True)
class Problem:
    """One set of throws against one twin."""

    prepared: Sequence[PreparedThrow]
    profile: TwinProfile
    calibration: ValveCalibration
    healthy: HealthyModel
    model: NoiseModel
    layout: Layout
    factor: Sequence[Sequence[Array]]
    """Of every throw's blocks."""
    linear: Sequence[Linear]
    """At "no effect"."""
    whitened: Sequence[Whitened]
    information: Sequence[Information]

    def basis(self, throw: int) -> Basis:
        """A throw at "no effect", whitened."""
        return Basis(self.linear[throw], self.factor[throw], self.whitened[throw])


def pose(
    prepared: Sequence[PreparedThrow],
    profile: TwinProfile,
    calibration: ValveCalibration,
    health: Health,
    layout: Layout,
) -> Problem:
    """Linearise at "no effect", with as much of the healthy machines' model as suits this one."""
    healthy, model = health.filters, health.noise
    linear = linearise(prepared, profile, calibration, healthy)
    if health.is_own:
        return _whitened(prepared, profile, calibration, healthy, model, layout, linear)
    is_stranger = not filters_help(prepared, linear, healthy)
    if is_stranger:
        healthy, model = nothing(), stranger(model)
        layout = layout_of(model)
        linear = linearise(prepared, profile, calibration, healthy)
    first = _whitened(prepared, profile, calibration, healthy, model, layout, linear)
    excess = misfit(first.whitened, layout.priors, model)
    if not is_stranger:
        # Machines of the type are never much nearer to their twin than the others.
        excess = {stage: max(factor, 1.0) for stage, factor in excess.items()}
    if all(factor == 1.0 for factor in excess.values()):
        return first
    scaled = scaled_to(model, excess)
    return _whitened(prepared, profile, calibration, healthy, scaled, layout, linear)


def _whitened(
    prepared: Sequence[PreparedThrow],
    profile: TwinProfile,
    calibration: ValveCalibration,
    healthy: HealthyModel,
    model: NoiseModel,
    layout: Layout,
    linear: Sequence[Linear],
) -> Problem:
    factor = [factors(p, model) for p in prepared]
    whitened = [
        whiten_throw(p, one, model, f) for p, one, f in zip(prepared, linear, factor, strict=True)
    ]
    return Problem(
        prepared,
        profile,
        calibration,
        healthy,
        model,
        layout,
        factor,
        linear,
        whitened,
        information(whitened),
    )
