"""What the standard's elements say of our machines: only what is measured or known.

A throw that landed is a load. Hours of operation are those of the control process, of which those without a
throw's motion are idle. Fuel, distance, engine and position are left out: nothing on board measures them.
"""

import math
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Final
from urllib.parse import quote

from sqlalchemy import ColumnElement, func, select

from machine.spec import load_spec
from server.clock import first_id_at, utc_now
from server.errors import ApiError, NotFoundError
from server.machines.machine_registry import KnownMachine, MachineRegistry
from server.schemas.history import Outcome
from server.store.database import Database
from server.store.models import Machine, Throw
from server.telematics.documents import PAGE_COUNT, Node, links

OEM_NAME: Final = "Menzi Muck"
"""Make of the machine type (docs/machine.md)."""
MAX_PAGE: Final = 1_000_000
VERSION: Final = 1
"""Of the schema, as the attribute `version` of a fleet says it."""


class FleetTelematics:
    """Answers the standard's requests from registry and history."""

    def __init__(self, database: Database, registry: MachineRegistry, base: str) -> None:
        """Args: base: path before `/Fleet`."""
        self._database = database
        self._registry = registry
        self._base = base
        self._model = load_spec().model_name.upper()

    def fleet(self, page: int) -> Node:
        """Snapshot of a page of machines, ordered by id.

        Raises:
            NotFoundError: there is no such page.
        """
        listed = sorted(self._registry.listed(), key=lambda known: known.machine_id)
        page_count = max(1, math.ceil(len(listed) / PAGE_COUNT))
        _require_page(page, page_count)
        shown = listed[(page - 1) * PAGE_COUNT : page * PAGE_COUNT]
        return {
            "@version": VERSION,
            "@snapshotTime": _text(utc_now()),
            "Links": links(f"{self._base}/Fleet", page, page_count),
            "Equipment": self._equipment(shown),
        }

    def single(self, make: str, model: str, serial: str) -> Node:
        """Snapshot of one machine.

        Raises:
            NotFoundError: there is none.
        """
        return self._equipment([self._known(make, model, serial)])[0]

    def load_counts(
        self,
        machine: tuple[str, str, str],
        period: tuple[datetime, datetime],
        page: int,
    ) -> Node:
        """Loads thrown by the end of each throw that landed in a period, oldest first.

        Args:
            machine: make, model and serial number.
            period: first and last moment, aware.
            page: from 1.

        Raises:
            NotFoundError: no such machine or page.
            ApiError: the period ends before it begins.
        """
        known = self._known(*machine)
        begin, end = period
        if end < begin:
            raise ApiError("bad_period", "The period ends before it begins.")
        landed = (Throw.machine_id == known.machine_id, Throw.outcome == Outcome.LANDED.value)
        inside = (
            *landed,
            Throw.throw_id >= first_id_at(begin),
            Throw.throw_id < first_id_at(end),
        )
        with self._database.read() as database:
            before = (
                database.scalar(
                    select(func.count())
                    .select_from(Throw)
                    .where(*landed, Throw.throw_id < first_id_at(begin))
                )
                or 0
            )
            count = database.scalar(select(func.count()).select_from(Throw).where(*inside)) or 0
            page_count = max(1, math.ceil(count / PAGE_COUNT))
            _require_page(page, page_count)
            skipped = (page - 1) * PAGE_COUNT
            times = database.scalars(
                select(Throw.created_utc)
                .where(*inside)
                .order_by(Throw.throw_id)
                .offset(skipped)
                .limit(PAGE_COUNT)
            ).all()
        names = "/".join(quote(part, safe="") for part in machine)
        path = (
            f"{self._base}/Fleet/Equipment/MakeModelSerial/{names}/CumulativeLoadCount/"
            f"{_text(begin)}/{_text(end)}"
        )
        return {
            "Links": links(path, page, page_count),
            "CumulativeLoadCount": [
                {"datetime": _text(at), "Count": before + skipped + index}
                for index, at in enumerate(times, start=1)
            ],
        }

    def _known(self, make: str, model: str, serial: str) -> KnownMachine:
        found = next((k for k in self._registry.listed() if k.machine_id == serial), None)
        if found is None or make.lower() != OEM_NAME.lower() or model.upper() != self._model:
            raise NotFoundError(
                "no_machine", f"There is no {make[:40]} {model[:40]} with serial {serial[:40]}."
            )
        return found

    def _equipment(self, machines: Sequence[KnownMachine]) -> list[Node]:
        ids = [known.machine_id for known in machines]
        with self._database.read() as database:
            enrolled = {
                row[0]: row[1]
                for row in database.execute(
                    select(Machine.machine_id, Machine.enrolled_utc).where(
                        Machine.machine_id.in_(ids)
                    )
                )
            }
            is_landed: ColumnElement[bool] = Throw.outcome == Outcome.LANDED.value
            loads = {
                row[0]: (row[1], row[2])
                for row in database.execute(
                    select(Throw.machine_id, func.count(), func.max(Throw.created_utc))
                    .where(Throw.machine_id.in_(ids), is_landed)
                    .group_by(Throw.machine_id)
                )
            }
        found: list[Node] = []
        for known in machines:
            header: Node = {
                "UnitInstallDateTime": _text(enrolled[known.machine_id]),
                "OEMName": OEM_NAME,
                "Model": self._model,
                "EquipmentID": known.name or known.machine_id,
                "SerialNumber": known.machine_id,
            }
            node: Node = {"EquipmentHeader": header}
            idle, operating = _hours(known)
            if idle is not None:
                node["CumulativeIdleHours"] = idle
            if known.machine_id in loads:
                count, at = loads[known.machine_id]
                node["CumulativeLoadCount"] = {"datetime": _text(at), "Count": count}
            if operating is not None:
                node["CumulativeOperatingHours"] = operating
            found.append(node)
        return found


def _hours(known: KnownMachine) -> tuple[Node | None, Node | None]:
    """Idle and operating hours as the machine last said them; None if this server has not heard any."""
    state, seen_utc = known.state, known.last_seen_utc
    if state is None or seen_utc is None or state.idle_s is None or state.operating_s is None:
        return None, None
    idle, operating = (
        {"datetime": _text(seen_utc), "Hour": round(seconds / 3600.0, 2)}
        for seconds in (state.idle_s, state.operating_s)
    )
    return idle, operating


def _require_page(page: int, page_count: int) -> None:
    if not 1 <= page <= page_count:
        raise NotFoundError("no_page", f"There is no page {page}; there are {page_count}.")


def _text(moment: datetime) -> str:
    """UTC to the second, as the standard writes times."""
    return moment.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
