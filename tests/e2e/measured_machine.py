"""Machine m001 as the first start of a demo measures it, in a minute; kept in build/ for the same code."""

import contextlib
import fcntl
import hashlib
import shutil
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from tests.e2e.stack import ROOT, Demo

KEPT = ROOT / "build" / "measured"
SOURCES = ("cli/calibrate.py", "cli/service/demo.py", "machine", "runtime", "sim_twin", "policies")
"""What the measurement depends on."""
MEASURED = ("profile.json", "calibration.json", "site.json")
MACHINE = "m001"


def measured_machine() -> Path:
    """Folder with the files of m001; measured now unless it was with the same code.

    One process measures, others wait for it.
    """
    with _alone():
        if not _folder().is_dir():
            with tempfile.TemporaryDirectory() as data:
                demo = Demo(Path(data))
                demo.start()
                try:
                    demo.ready()
                finally:
                    demo.stop()
                _keep(demo.machines)
    return _folder()


def keep(machines: Path) -> None:
    """Keep what a first start measured, unless the same code did so before."""
    with _alone():
        if not _folder().is_dir():
            _keep(machines)


@contextlib.contextmanager
def _alone() -> Iterator[None]:
    KEPT.mkdir(parents=True, exist_ok=True)
    with (KEPT / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _keep(machines: Path) -> None:
    for old in KEPT.glob("*/"):
        shutil.rmtree(old)
    part = Path(tempfile.mkdtemp(dir=KEPT))
    for name in MEASURED:
        shutil.copy(machines / f"{MACHINE}.{name}", part)
    part.rename(_folder())


def give(machines: Path, names: tuple[str, ...] = (MACHINE,)) -> None:
    """Put the measured files into the folder of a demo that has not begun, for machines of these names."""
    machines.mkdir(parents=True)
    for name in MEASURED:
        text = (measured_machine() / f"{MACHINE}.{name}").read_text(encoding="utf-8")
        for machine_id in names:
            own = text.replace(f'"machine_id": "{MACHINE}"', f'"machine_id": "{machine_id}"')
            (machines / f"{machine_id}.{name}").write_text(own, encoding="utf-8")


def _folder() -> Path:
    return KEPT / _digest()


@cache
def _digest() -> str:
    digest = hashlib.sha256()
    for source in SOURCES:
        path = ROOT / source
        files = sorted(path.rglob("*")) if path.is_dir() else [path]
        for file in files:
            if file.is_file() and "__pycache__" not in file.parts:
                digest.update(file.relative_to(ROOT).as_posix().encode())
                digest.update(file.read_bytes())
    return digest.hexdigest()[:16]
