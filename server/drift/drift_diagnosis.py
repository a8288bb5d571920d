"""Diagnoses of drifts: throws since the change point against throws of before, asked for or by themselves."""

import logging
from collections.abc import Sequence
from typing import Final

from sqlalchemy import select

from diagnosis.loading.kept_reference import ADVISED_REFERENCE_COUNT
from machine.conventions import Mode
from server.accounts.audit_chain import SERVER, Actor
from server.deployments.machine_policies import MachinePolicies
from server.drift.drift_test import Change
from server.drift.found_drift import CHANGE_WORDS, FoundDrift, TestedThrow, found_drifts
from server.errors import ApiError, ConflictError, NotFoundError
from server.gap.gap_service import GapService
from server.machines.machine_registry import MachineRegistry
from server.schemas.console import View
from server.schemas.gap import (
    MIN_REFERENCE_THROWS_COUNT,
    MIN_THROWS_COUNT,
    GapRunRequest,
    GapRunRow,
    GapState,
)
from server.settings import Settings
from server.store.database import Database
from server.store.models import GapRun

logger = logging.getLogger(__name__)

DIAGNOSED_COUNT: Final = 12
"""Newest throws since the change that are diagnosed (docs/diagnosis.md); so many start one by itself."""
UNSURE_COUNT: Final = 5
"""Throws before the estimated change point that are not compared with: of biases of one spread, 95 % of the
estimates lie at most so late (benchmarks/drift.py)."""
_SEARCHED_COUNT: Final = 50
"""Newest runs of a machine among which a drift's are looked for."""
_WITHOUT_RESULT: Final = frozenset({GapState.FAILED, GapState.CANCELLED, GapState.INTERRUPTED})


class DriftView(View):
    """A drift that lasts, and its diagnosis."""

    mode: Mode
    change: Change
    words: str
    """How throws land now."""
    throw_count: int
    """Measured throws since the change, by its estimate."""
    diagnosed_throw_count: int
    """Those of them that a diagnosis takes: landed, with a log, the newest."""
    reference_throw_count: int
    """Throws of before that it compares with; 0: kept reference throws, else healthy machines of the type."""
    problem: str
    """Why it cannot be diagnosed yet; empty if it can."""
    gap_run_id: str | None
    """Newest diagnosis of this drift that goes on or has a result."""


class DriftDiagnoses:
    """Finds what a diagnosis of a drift takes, and starts it."""

    def __init__(
        self,
        database: Database,
        registry: MachineRegistry,
        machine_policies: MachinePolicies,
        gap: GapService,
        settings: Settings,
    ) -> None:
        self._database = database
        self._registry = registry
        self._machine_policies = machine_policies
        self._gap = gap
        self._is_automatic = settings.drift_diagnoses

    def view(self, machine_id: str) -> list[DriftView]:
        """Drifts of a machine.

        Raises:
            NotFoundError: no such machine.
        """
        return [self._view(machine_id, drift) for drift in self._drifts(machine_id)]

    def start(self, machine_id: str, mode: Mode, actor: Actor) -> GapRunRow:
        """Queue the diagnosis of a mode's drift.

        Raises:
            ApiError: no drift, too few throws, or too many diagnoses waiting.
        """
        for drift in self._drifts(machine_id):
            if drift.mode is mode:
                return self._start(machine_id, drift, actor)
        raise NotFoundError(
            "no_drift", f"{mode.value.upper()} throws of {machine_id} do not drift any more."
        )

    def start_due(self, machine_id: str, drifts: Sequence[FoundDrift]) -> None:
        """Queue diagnoses of drifts that have enough throws and none yet, where the settings say so."""
        if not self._is_automatic:
            return
        for drift in drifts:
            try:
                is_due = len(_diagnosed(drift)) >= DIAGNOSED_COUNT
                if is_due and not self._runs(machine_id, drift):
                    self._start(machine_id, drift, SERVER)
            except ApiError as error:
                logger.warning("the drift of %s is not diagnosed: %s", machine_id, error)
            except Exception:
                logger.exception("the drift of %s could not be diagnosed", machine_id)

    def _drifts(self, machine_id: str) -> list[FoundDrift]:
        self._registry.get(machine_id)
        return list(found_drifts(self._database, self._machine_policies, machine_id))

    def _start(self, machine_id: str, drift: FoundDrift, actor: Actor) -> GapRunRow:
        problem = _problem(drift)
        if problem:
            raise ConflictError("too_few_throws", problem)
        return self._gap.create(machine_id, drift_request(drift), actor)

    def _view(self, machine_id: str, drift: FoundDrift) -> DriftView:
        runs = self._runs(machine_id, drift)
        return DriftView(
            mode=drift.mode,
            change=drift.change,
            words=f"{drift.mode.value.upper()} throws land {CHANGE_WORDS[drift.change]}",
            throw_count=len(drift.since),
            diagnosed_throw_count=len(_diagnosed(drift)),
            reference_throw_count=len(_references(drift)),
            problem=_problem(drift),
            gap_run_id=next(
                (run.gap_run_id for run in runs if GapState(run.state) not in _WITHOUT_RESULT), None
            ),
        )

    def _runs(self, machine_id: str, drift: FoundDrift) -> list[GapRun]:
        """Diagnoses of throws since the change alone, newest first: whoever started them."""
        query = (
            select(GapRun)
            .where(GapRun.machine_id == machine_id)
            .order_by(GapRun.gap_run_id.desc())
            .limit(_SEARCHED_COUNT)
        )
        with self._database.read() as session:
            rows = session.scalars(query).all()
        since = {throw.throw_id for throw in drift.since}
        return [row for row in rows if since.issuperset(row.throw_ids)]


def drift_request(drift: FoundDrift) -> GapRunRequest:
    """What a drift's diagnosis is asked with."""
    return GapRunRequest(
        throw_ids=_diagnosed(drift), reference_throw_ids=_references(drift) or None
    )


def _diagnosed(drift: FoundDrift) -> tuple[str, ...]:
    return _usable(drift.since)[-DIAGNOSED_COUNT:]


def _references(drift: FoundDrift) -> tuple[str, ...]:
    """Newest throws that surely are of before the change; none where there are too few."""
    found = _usable(drift.before[:-UNSURE_COUNT])[-ADVISED_REFERENCE_COUNT:]
    return found if len(found) >= MIN_REFERENCE_THROWS_COUNT else ()


def _usable(throws: Sequence[TestedThrow]) -> tuple[str, ...]:
    return tuple(throw.throw_id for throw in throws if throw.has_log)


def _problem(drift: FoundDrift) -> str:
    count = len(_diagnosed(drift))
    if count >= MIN_THROWS_COUNT:
        return ""
    return (
        f"{count} throws since the change have landed with a log; a diagnosis takes at least "
        f"{MIN_THROWS_COUNT}, better {DIAGNOSED_COUNT}. Throw more."
    )
