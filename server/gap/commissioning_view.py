"""The last commissioning of a machine, as the console shows it; the server reads it and never starts one."""

import shlex

from diagnosis.identification.commissioning_record import (
    PHASE_WORDS,
    STEPS,
    Commissioning,
    JointFit,
    load_record,
)
from diagnosis.identification.quantity import Quantity
from diagnosis.loading.kept_reference import advice, words_of_days
from diagnosis.report.diagnosis_words import FactWords
from machine.errors import UsageError
from reports.number_format import percent
from server.errors import NotFoundError
from server.machines.twin_files import TwinFiles
from server.schemas.gap import CommissionedJointView, CommissionedStepView, CommissioningView


def commissioning_view(twins: TwinFiles, machine_id: str) -> CommissioningView:
    """What `downrange commission` has measured of a machine so far."""
    days = twins.reference(machine_id).days()
    problem = ""
    try:
        found = load_record(twins.file(machine_id, "commissioning.json"), machine_id)
    except UsageError as error:
        found, problem = Commissioning(machine_id=machine_id), str(error)
    steps = (
        CommissionedStepView(
            name=words,
            done_utc=None if (done := found.steps.get(step)) is None else done.done_utc,
            words="" if done is None else done.words,
        )
        for step, words in STEPS.items()
    )
    out = shlex.quote(str(twins.folder))
    return CommissioningView(
        command=f"downrange commission --plant PLANT --machine-id {machine_id} --out {out}",
        steps=tuple(steps) if found.steps else (),
        joints=tuple(_joint(fit) for fit in found.joints),
        quantities=tuple(
            FactWords(name=name, value=_size(known)) for name, known in found.quantities()
        ),
        flags=tuple(found.flags()),
        reference=". ".join(filter(None, [words_of_days(days), advice(days)])),
        has_report=twins.file(machine_id, "commissioning.html").is_file(),
        problem=problem,
    )


def commissioning_report(twins: TwinFiles, machine_id: str) -> bytes:
    """The report that the commissioning wrote.

    Raises:
        NotFoundError: there is none.
    """
    try:
        return twins.file(machine_id, "commissioning.html").read_bytes()
    except OSError as error:
        raise NotFoundError(
            "no_commissioning_report", f"{machine_id} has no report of a commissioning."
        ) from error


def _joint(fit: JointFit) -> CommissionedJointView:
    left = fit.unexplained_by_phase_ratio
    phase = max(left, key=left.__getitem__, default="")
    return CommissionedJointView(
        joint=fit.joint,
        model="oil spring" if fit.is_oil_spring else "linear",
        explained_ratio=fit.explained_ratio,
        linear_explained_ratio=fit.linear_explained_ratio,
        rest=f"{percent(left[phase])} in {PHASE_WORDS.get(phase, phase)}" if phase else "",
        at_bound=fit.at_bound,
    )


def _size(known: Quantity) -> str:
    if known.value is None:
        return known.why
    ends = (
        "" if known.ci90 is None else f", 90 % interval {known.ci90[0]:.4g} to {known.ci90[1]:.4g}"
    )
    return f"{known.value:.4g} {known.unit}".strip() + f"{ends}, n {known.count}"
