"""A diagnosis in a process of its own, which reads log files and answers with JSON and an HTML page."""

import logging
import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, cast

from diagnosis.correction import found_effects
from diagnosis.report.diagnosis_page import diagnosis_html
from diagnosis.verdict import Diagnosis
from machine.errors import DownrangeError
from server.child_process import Send, run_child
from server.throws.limited_reader import LimitedLogReader
from sim_twin.twin.profile import TwinProfile

if TYPE_CHECKING:
    from diagnosis.loading.throw_data import LoadedSet

logger = logging.getLogger(__name__)

PROGRESS_PERIOD_S = 0.25
READ_S = 120.0
"""Time for one log: the process has a low priority."""

Diagnose = Callable[["GapJob", Callable[[float, str], None]], Diagnosis]
Progress = Callable[[float, str], None]


@dataclass(frozen=True, slots=True)
class GapJob:
    """One diagnosis, as it travels to the process."""

    title: str
    log_paths: tuple[Path, ...]
    profile: TwinProfile
    reference_paths: tuple[Path, ...] = ()
    """Logs of the machine while it was healthy; none: it is compared with its type."""
    names: Mapping[str, str] = field(default_factory=dict[str, str])
    """What people call a log, by its file's name, which is a hash."""
    reference_days: Mapping[str, int] = field(default_factory=dict[str, int])
    """Kept reference throws by day."""
    material_m: float | None = None
    """An effect that moves the impact by less is not claimed."""
    machines_folder: Path | None = None
    """Where the models of healthy machines are kept for the next diagnosis."""


@dataclass(frozen=True, slots=True)
class GapAnswer:
    """Result of a diagnosis; `result` is finite JSON of a Diagnosis, `report` a compressed page."""

    verdict: str
    sentence: str
    effect_count: int
    result: Mapping[str, Any]
    report: bytes


def diagnose_logs(job: GapJob, progress: Progress) -> Diagnosis:
    """Load the logs and diagnose them."""
    # Imported here: the server's own process does not need the simulator.
    from diagnosis.diagnose import diagnose_throws
    from diagnosis.healthy.health_store import health_store
    from diagnosis.loading.kept_reference import with_reference_stated
    from diagnosis.loading.logs import load_throws

    progress(0.0, "reading logs")
    reader = LimitedLogReader(READ_S)
    try:
        loaded = _named(load_throws(job.log_paths, read_log=reader.read), job.names)
        reference = None
        if job.reference_paths:
            healthy = load_throws(job.reference_paths, read_log=reader.read)
            reference = _named(healthy, job.names)
    finally:
        reader.close()
    store = None
    if job.machines_folder is not None and loaded.throws:
        store = health_store(job.machines_folder, loaded.throws[0].machine_id)
    found = diagnose_throws(
        loaded, job.profile, progress, reference=reference, material_m=job.material_m, store=store
    )
    return with_reference_stated(found, job.reference_days)


def _named(loaded: "LoadedSet", names: Mapping[str, str]) -> "LoadedSet":
    """The loaded logs, with refused ones named by their throw instead of their path."""

    def renamed(path: Path, reason: str) -> tuple[Path, str]:
        name = names.get(path.name, path.name)
        return Path(name), reason.replace(f"{path} ", "it ").replace(str(path), name)

    return replace(loaded, refused=tuple(renamed(*entry) for entry in loaded.refused))


class GapProcess:
    """Runs one diagnosis at a time; `run` blocks until it ended."""

    def __init__(self, diagnose: Diagnose = diagnose_logs) -> None:
        self._diagnose = diagnose

    def run(self, job: GapJob, progress: Progress, is_cancelled: Callable[[], bool]) -> GapAnswer:
        """Diagnose.

        Args:
            job: what to diagnose.
            progress: called with the share done and the name of the step.
            is_cancelled: polled several times a second; True kills the process.

        Raises:
            ChildKilledError: `is_cancelled` returned True.
            ChildFailedError: the process failed, with the reason.
        """
        work = (job, self._diagnose)

        def take(_kind: str, content: tuple[float, str]) -> None:
            progress(*content)

        return run_child(send_answer, work, "diagnosis", take, is_cancelled)


# In the process --------------------------------------------------------------------------------------


def send_answer(job: GapJob, diagnose: Diagnose, send: Send) -> None:
    """Diagnose; sends ("progress", (share, text)), then ("done", GapAnswer) or ("failed", reason)."""
    sent_s = -1e9

    def tell(share: float, text: str) -> None:
        nonlocal sent_s
        if monotonic() - sent_s >= PROGRESS_PERIOD_S:
            sent_s = monotonic()
            send(("progress", (share, text)))

    try:
        found = diagnose(job, tell)
        send(("done", answer_of(found, job.title)))
    except DownrangeError as error:
        send(("failed", str(error)))
    except (ValueError, MemoryError) as error:
        logger.exception("diagnosis failed")
        send(("failed", f"{type(error).__name__}: {error}"))
    except Exception as error:
        logger.exception("diagnosis failed")
        send(
            ("failed", f"the diagnosis made a mistake ({type(error).__name__}: {error}); report it")
        )


def answer_of(found: Diagnosis, title: str) -> GapAnswer:
    """A diagnosis as it is stored.

    Raises:
        ValueError: a number of the verdict itself is not finite.
    """
    result = cast("dict[str, Any]", finite(found.model_dump(mode="json")))
    # Validated as the console reads it: evidence may lack a number, the verdict may not.
    Diagnosis.model_validate(result)
    return GapAnswer(
        verdict=found.verdict.value,
        sentence=found.sentence,
        effect_count=len(found_effects(found)),
        result=result,
        report=zlib.compress(diagnosis_html(found, title).encode()),
    )


def finite(value: Any) -> Any:
    """The same tree with None for numbers that JSON does not have."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(k): finite(v) for k, v in cast("Mapping[Any, Any]", value).items()}
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        return [finite(item) for item in cast("Sequence[Any]", value)]
    return value
