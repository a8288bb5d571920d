"""Loads policy versions that people brought in a process of its own, with limits of time and memory."""

import logging
import time
from collections.abc import Callable
from typing import Final

from machine.errors import PolicyError
from machine.policy_card import PolicyFiles
from machine.spec import load_spec
from runtime.control.policy_check import check_version
from server.child_process import (
    ChildFailedError,
    ChildKilledError,
    Send,
    limit_resources,
    run_child,
)

logger = logging.getLogger(__name__)

TIME_LIMIT_S: Final = 60.0
"""From the start of the process; a usual check takes 2 s on an idle core."""
MEMORY_BYTES: Final = 4 * 1024**3
"""Address space of the process; the network's runtime reserves 1 GiB of it before it loads anything."""

Check = Callable[[PolicyFiles], None]


def check_in_child(
    files: PolicyFiles, check: Check | None = None, *, time_limit_s: float = TIME_LIMIT_S
) -> None:
    """Check a version as machines do, where a network that hangs or grows harms nothing.

    Args:
        files: as they were read.
        check: what is done in the process; by default `check_version` for this machine type.
        time_limit_s: then the process is killed.

    Raises:
        PolicyError: what is wrong with it, or that it exceeds a limit.
    """
    name = files.card.policy_id
    end_s = time.monotonic() + time_limit_s
    try:
        found = run_child(
            _send_finding,
            (files, check or _check),
            "check",
            lambda _kind, _content: None,
            lambda: time.monotonic() > end_s,
        )
    except ChildKilledError as error:
        raise PolicyError(
            f"{name} takes more than {time_limit_s:.0f} s to load, so no machine is given it"
        ) from error
    except ChildFailedError as error:
        logger.warning("%s could not be checked: %s", name, error)
        raise PolicyError(f"{name} cannot be loaded: {error}") from error
    if found is not None:
        raise PolicyError(found)


# In the process --------------------------------------------------------------------------------------


def _check(files: PolicyFiles) -> None:
    check_version(files, load_spec())


def _send_finding(files: PolicyFiles, check: Check, send: Send) -> None:
    """Check; sends ("done", None or what is wrong) or ("failed", why it could not be checked)."""
    limit_resources(memory_bytes=MEMORY_BYTES)
    try:
        check(files)
    except PolicyError as error:
        send(("done", str(error)))
    except MemoryError:
        send(("failed", f"it needs more than {MEMORY_BYTES >> 30} GiB"))
    except Exception as error:
        logger.exception("a version could not be checked")
        send(("failed", f"{type(error).__name__}: {error}"))
    else:
        send(("done", None))
