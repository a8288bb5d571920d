"""One set of throws against one twin, linearised at "no effect"."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from diagnosis.causes.evidence import Information, screen, total
from diagnosis.causes.form_error import factors, widened
from diagnosis.causes.leftovers import in_units, left_of, levels
from diagnosis.causes.linear import Linear
from diagnosis.causes.own_noise import AtNone, at_none
from diagnosis.causes.parameters import Layout
from diagnosis.causes.parameters import layout as layout_of
from diagnosis.causes.residuals import linearise
from diagnosis.causes.whitening import (
    Basis,
    Whitened,
    apart,
    beside_named,
    information,
    whiten_throw,
)
from diagnosis.healthy.adapt import CLEAR_LOG_POWER, filters_help, misfit, scaled_to
from diagnosis.healthy.filters import HealthyModel, nothing
from diagnosis.healthy.health import Health
from diagnosis.healthy.noise import NoiseModel
from diagnosis.healthy.stranger import as_near_as_shown, stranger
from diagnosis.loading.prepared import PreparedThrow
from diagnosis.worker_process import WorkerProcess
from machine.calibration import ValveCalibration
from machine.conventions import ACTIVE_JOINTS, Array
from sim_twin.twin.profile import TwinProfile

GLANCE_COUNT = 6
"""Fewer throws at a glance would show too little: then it is at all of them."""
TYPE_LOOKS = ((1.0, CLEAR_LOG_POWER),)
"""Looks at the misfit: the least factor, and from which log power on it is clear. Machines of the type are
never much nearer to their twin than the others."""
STRANGER_LOOKS = ((0.0, 0.0), (1.0, 0.0))
"""A stranger's are twice: a factor scales its discrepancy, and not the noise that is left beside it."""
OF_THROWS = (
    "prepared",
    "plain",
    "factor",
    "linear",
    "whitened",
    "information",
    "off",
    "basis",
    "at_none",
)
"""Fields of a problem with an entry for every throw."""


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
    basis: Sequence[Basis]
    """Every throw at "no effect", for hypotheses."""
    none_levels: Mapping[str, float]
    """What no effect leaves in every block (`levels`), in a healthy machine's noise: where nothing is
    explained, nothing is off by its form."""
    at_none: Sequence[AtNone]
    """What no effect leaves of every throw, beside the throw's nuisances, in the channels' own units."""
    worker: WorkerProcess | None = None
    """Evaluates half of the sets."""

    def shared_with(self, worker: WorkerProcess | None) -> "Problem":
        """The same problem, of whose sets a worker process evaluates half."""
        if worker is not None:
            worker.hold(self)
        return replace(self, worker=worker)

    def at_a_glance(self) -> "Problem":
        """Every other throw of each mode, for a look at many sets of which few are tried again."""
        modes = [p.throw.mode for p in self.prepared]
        by_mode = [[i for i, one in enumerate(modes) if one == mode] for mode in sorted(set(modes))]
        chosen = sorted(i for own in by_mode for i in own[::2])
        if len(chosen) < GLANCE_COUNT:
            return self
        return replace(self, **{f: [getattr(self, f)[i] for i in chosen] for f in OF_THROWS})


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
    healthy, model = health.filters, health.noise
    linear = linearise(prepared, profile, calibration, healthy)
    is_stranger = not health.is_own and not filters_help(prepared, linear, healthy)
    if is_stranger:
        healthy, model = nothing(), stranger(model, (1.0,) * len(ACTIVE_JOINTS))
        layout = layout_of(model)
        linear = linearise(prepared, profile, calibration, healthy)
    found = _whitened(prepared, profile, calibration, healthy, model, layout, linear)
    looks = STRANGER_LOOKS if is_stranger else TYPE_LOOKS
    for least_ratio, clear_log_power in () if health.is_own else looks:
        excess = misfit(found.whitened, layout.priors, model, clear_log_power)
        excess = {stage: max(factor, least_ratio) for stage, factor in excess.items()}
        if any(factor != 1.0 for factor in excess.values()):
            model = scaled_to(model, excess)
            found = _whitened(prepared, profile, calibration, healthy, model, layout, linear)
    if is_stranger:
        near = as_near_as_shown(health.noise, total(found.information))
        model = near.model_copy(update={"channels": model.channels})
        # Whitening knows of no scatter of machines.
        found = replace(found, model=model, layout=layout_of(model))
    return _with_form_error(found)


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
        [],
        {},
        [],
    )


def _with_form_error(first: Problem) -> Problem:
    """With the discrepancy that effects bring wherever the twin without any is off.

    From here on a shape moves what it looks like as well (`Priors.looks_like`).
    """
    prepared, model = first.prepared, first.model
    mean = screen(total(first.information), first.layout.priors).mean
    off = [
        in_units(p, f, left_of(w, mean))
        for p, f, w in zip(prepared, first.plain, first.whitened, strict=True)
    ]
    factor = [widened(p, model, f, o) for p, f, o in zip(prepared, first.plain, off, strict=True)]
    whitened = [
        whiten_throw(p, one, model, f, beside=first.beside)
        for p, one, f in zip(prepared, first.linear, factor, strict=True)
    ]
    told = information(whitened)
    none = screen(total(told), first.layout.priors).mean
    return replace(
        first,
        layout=replace(first.layout, priors=first.layout.priors._replace(looks_like=first.beside)),
        factor=factor,
        off=off,
        whitened=whitened,
        information=told,
        none_levels=levels(first.whitened, mean),
        basis=[
            Basis(one, f, w, first.beside)
            for one, f, w in zip(first.linear, factor, whitened, strict=True)
        ],
        at_none=[
            at_none(p, f, w, none) for p, f, w in zip(prepared, factor, whitened, strict=True)
        ],
    )
