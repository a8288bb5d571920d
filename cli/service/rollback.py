"""`downrange rollback`: a machine goes back to its policy version before; on its own computer."""

import fcntl
import time
from pathlib import Path
from typing import Annotated, Literal

import tyro

from machine.conventions import Mode
from machine.errors import UsageError
from runtime.policies.puller import ROLLBACK_FILE, RollbackRequest
from runtime.policies.slots import PolicySlots, version_words

LOOK_PERIOD_S = 0.05


def run(
    *,
    data: Path,
    mode: Literal["2d", "3d"],
    timeout_s: Annotated[float, tyro.conf.arg(name="timeout")] = 10.0,
) -> int:
    """Put the policy version before into use; exit 3 while a running machine has not done so yet.

    A running machine switches while no plan is armed; one that does not run begins with that version. No
    rollback leads back to the version that was in use: deploy it.

    Args:
        data: the machine's data folder, as given to `downrange machine`.
        mode: 2d or 3d.
        timeout_s: how long to wait for a running machine.
    """
    lock_file = data / "machine.lock"
    if not lock_file.is_file():
        raise UsageError(f"{data} is no data folder of a machine; name the one of its --data")
    slots = PolicySlots(data / "policies")
    chosen = Mode(mode)
    with lock_file.open("r+") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return _ask(slots, data, chosen, timeout_s)
        # What a machine that died has not done yet is not done on top of this.
        (data / "policies" / ROLLBACK_FILE).unlink(missing_ok=True)
        now = slots.roll_back(chosen)
    print(f"{mode}: the machine starts with {version_words(now)}")
    return 0


def _ask(slots: PolicySlots, data: Path, mode: Mode, timeout_s: float) -> int:
    previous = slots.previous(mode)
    request = data / "policies" / ROLLBACK_FILE
    part = request.with_suffix(".part")
    part.write_text(
        RollbackRequest(mode=mode, policy_sha256=previous).model_dump_json() + "\n",
        encoding="utf-8",
    )
    part.replace(request)
    end_s = time.monotonic() + timeout_s
    while time.monotonic() < end_s:
        if slots.of(mode).current == previous:
            print(f"{mode.value}: the machine throws with {version_words(previous)}")
            return 0
        time.sleep(LOOK_PERIOD_S)
    print(
        f"{mode.value}: asked for {version_words(previous)}; the machine has not switched yet. "
        "It does so when no plan is armed; its log says why it cannot."
    )
    return 3
