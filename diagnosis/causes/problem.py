"""One set of throws against one twin, linearised at "no effect"."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.causes.parameters import Layout
from diagnosis.causes.parameters import layout as layout_of
from diagnosis.causes.residuals import Linear, linearise
from diagnosis.causes.selection import Information, screen, total
from diagnosis.causes.whitening import (
    Basis,
    Whitened,
    apart,
    beside_named,
    factors,
    information,
    left_of,
    whiten_throw,
    widened,
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
    plain: Sequence[Sequence[Array]]
    """Cholesky factors of a healthy machine's noise, of every throw's blocks."""
    factor: Sequence[Sequence[Array]]
    """Those of the noise with which hypotheses are weighed (`widened`)."""
    linear: Sequence[Linear]
    """At "no effect"."""
    whitened: Sequence[Whitened]
    information: Sequence[Information]
    beside: Array
    """What named slopes explain of the shapes (`beside_named`)."""
    off: Sequence[Array]
    """What the twin without any effect leaves of every throw, (n,), in the channels' own units."""

    def basis(self, throw: int) -> Basis:
        """A throw at "no effect", whitened."""
        return Basis(self.linear[throw], self.factor[throw], self.whitened[throw], self.beside)


def pose(
    prepared: Sequence[PreparedThrow],
    profile: TwinProfile,
    calibration: ValveCalibration,
    health: Health,
    layout: Layout,
) -> Problem:
    """Linearise at "no effect", with as much of the healthy machines' model as suits this one.

    An effect's discrepancy is in the noise from here on (`widened`), wherever the twin without any is off.
    """
    first = _healthy(prepared, profile, calibration, health, layout)
    data = total(first.information)
    mean = screen(data, first.layout.priors).mean
    off = [
        _in_units(p, f, left_of(w, mean))
        for p, f, w in zip(prepared, first.plain, first.whitened, strict=True)
    ]
    factor = [
        widened(p, first.model, f, o) for p, f, o in zip(prepared, first.plain, off, strict=True)
    ]
    whitened = [
        whiten_throw(p, one, first.model, f, beside=first.beside)
        for p, one, f in zip(prepared, first.linear, factor, strict=True)
    ]
    found = information(whitened)
    return replace(first, factor=factor, off=off, whitened=whitened, information=found)


def _healthy(
    prepared: Sequence[PreparedThrow],
    profile: TwinProfile,
    calibration: ValveCalibration,
    health: Health,
    layout: Layout,
) -> Problem:
    """With the noise of a healthy machine."""
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
    raw = [
        whiten_throw(p, one, model, f) for p, one, f in zip(prepared, linear, factor, strict=True)
    ]
    beside = beside_named(total(information(raw)), layout)
    whitened = [apart(one, beside, model) for one in raw]
    return Problem(
        prepared,
        profile,
        calibration,
        healthy,
        model,
        layout,
        factor,
        factor,
        linear,
        whitened,
        information(whitened),
        beside,
        [],
    )


def _in_units(prepared: PreparedThrow, factor: Sequence[Array], white: Array) -> Array:
    """A whitened vector (n,) in the channels' own units."""
    out = np.zeros_like(white)
    for block, lower in zip(prepared.blocks, factor, strict=True):
        out[block.rows] = lower @ white[block.rows]
    return out
