"""Runs a validation in a separate process at low priority; the parent receives its parts and may kill it.

The process is spawned, not forked, because the server holds Zenoh's threads; it exits when the server is
gone.
"""

import logging
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Final, cast

from evaluation.execution.executor_choice import open_executor
from evaluation.validation.validation import (
    ValidationJob,
    ValidationListener,
    ValidationResult,
    validate,
)
from machine.errors import DownrangeError
from sim_twin.child_processes import end_with_parent

logger = logging.getLogger(__name__)

NICENESS: Final = 15
"""As a diagnosis's: below previews (5)."""
POLL_S: Final = 0.2
END_WAIT_S: Final = 2.0


@dataclass(frozen=True, slots=True)
class CampaignProcesses:
    """What carries out the throws of validations."""

    process_count: int = 1
    scheduler: str | None = None
    """Address of a Dask scheduler; then its workers throw."""


Validate = Callable[[ValidationJob, CampaignProcesses, ValidationListener], ValidationResult]


class ValidationFailedError(Exception):
    """The process ended without a result."""


class ValidationKilledError(Exception):
    """The validation was cancelled."""


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
        self._context = multiprocessing.get_context("spawn")
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
            ValidationKilledError: `is_cancelled` returned True.
            ValidationFailedError: the process failed, with the reason.
        """
        ours, theirs = self._context.Pipe(duplex=False)
        # Not a daemon: those may have no processes of their own.
        process = self._context.Process(
            target=run_validation,
            args=(job, self._processes, self._validate, theirs),
            name="validation",
        )
        process.start()
        theirs.close()
        try:
            while True:
                if is_cancelled():
                    raise ValidationKilledError
                if not ours.poll(POLL_S):
                    continue
                try:
                    kind, content = ours.recv()
                except EOFError:
                    process.join(END_WAIT_S)
                    raise ValidationFailedError(
                        f"the validation ended without a result (exit code {process.exitcode}); "
                        "the server's log may say more"
                    ) from None
                if kind == "progress":
                    listener.progress(*content)
                elif kind == "part":
                    listener.part(*content)
                elif kind == "failed":
                    raise ValidationFailedError(content)
                else:
                    return cast("ValidationResult", content)
        finally:
            ours.close()
            _end(process)


def _end(process: Any) -> None:
    process.join(0.5)
    if process.is_alive():
        process.terminate()
        process.join(END_WAIT_S)
    if process.is_alive():
        process.kill()
        process.join()
    process.close()


# In the process --------------------------------------------------------------------------------------


def run_validation(
    job: ValidationJob,
    processes: CampaignProcesses,
    validate_version: Validate,
    answers: Connection,
) -> None:
    """Entry point of the process."""
    os.nice(NICENESS)
    end_with_parent()
    # A cancelled validation ends its own worker processes.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    listener = ValidationListener(
        progress=lambda share, text: answers.send(("progress", (share, text))),
        part=lambda name, answer: answers.send(("part", (name, answer))),
    )
    try:
        # Progress lines of the campaigns belong on no terminal here.
        with open(os.devnull, "w", encoding="utf-8") as nowhere:
            sys.stderr = nowhere
            try:
                result = validate_version(job, processes, listener)
            finally:
                sys.stderr = sys.__stderr__
        answers.send(("done", result))
    except DownrangeError as error:
        answers.send(("failed", str(error)))
    except Exception as error:
        logger.exception("validation failed")
        text = f"the validation made a mistake ({type(error).__name__}: {error}); report it"
        answers.send(("failed", text))
