"""A validation in a process of its own, which sends every part that has ended."""

import logging
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from evaluation.execution.executor_choice import open_executor
from evaluation.validation.validation import (
    ValidationJob,
    ValidationListener,
    ValidationResult,
    validate,
)
from machine.errors import DownrangeError
from server.child_process import Send, run_child

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class CampaignProcesses:
    """What carries out the throws of validations."""

    process_count: int = 1
    scheduler: str | None = None
    """Address of a Dask scheduler; then its workers throw."""


Validate = Callable[[ValidationJob, CampaignProcesses, ValidationListener], ValidationResult]


def validate_by(
    job: ValidationJob, processes: CampaignProcesses, listener: ValidationListener
) -> ValidationResult:
    """Validate with the executor of the server's settings."""
    with open_executor(processes.process_count, processes.scheduler) as executor:
        return validate(job, executor, listener)


class ValidationProcess:
    """Runs one validation at a time; `run` blocks until it ended."""

    def __init__(
        self, processes: CampaignProcesses, validate_version: Validate = validate_by
    ) -> None:
        self._processes = processes
        self._validate = validate_version

    def run(
        self, job: ValidationJob, listener: ValidationListener, is_cancelled: Callable[[], bool]
    ) -> ValidationResult:
        """Validate.

        Args:
            job: what to validate.
            listener: called in this process.
            is_cancelled: polled several times a second; True kills the process.

        Raises:
            ChildKilledError: `is_cancelled` returned True.
            ChildFailedError: the process failed, with the reason.
        """

        def take(kind: str, content: tuple[Any, ...]) -> None:
            (listener.part if kind == "part" else listener.progress)(*content)

        work = (job, self._processes, self._validate)
        return run_child(send_result, work, "validation", take, is_cancelled)


# In the process --------------------------------------------------------------------------------------


def send_result(
    job: ValidationJob, processes: CampaignProcesses, validate_version: Validate, send: Send
) -> None:
    """Validate; sends ("progress", (share, text)), ("part", (name, answer)), then "done" or "failed"."""
    listener = ValidationListener(
        progress=lambda share, text: send(("progress", (share, text))),
        part=lambda name, answer: send(("part", (name, answer))),
    )
    try:
        # Progress lines of the campaigns belong on no terminal here.
        with open(os.devnull, "w", encoding="utf-8") as nowhere:
            sys.stderr = nowhere
            try:
                result = validate_version(job, processes, listener)
            finally:
                sys.stderr = sys.__stderr__
        send(("done", result))
    except DownrangeError as error:
        send(("failed", str(error)))
    except Exception as error:
        logger.exception("validation failed")
        text = f"the validation made a mistake ({type(error).__name__}: {error}); report it"
        send(("failed", text))
