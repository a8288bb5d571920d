"""Runs the diagnosis or a baseline on every data set of a challenge: resumable and blind.

It reads the data folder only: no function here takes the sealed file.
"""

import json
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from time import perf_counter
from typing import Any, Final

from challenge.baselines.lag import lag_rmse
from challenge.baselines.tune_all import evolution, largest_z
from challenge.make import MANIFEST, PROFILE_NAME, REFERENCE, spread
from diagnosis.diagnose import diagnose_throws
from diagnosis.healthy.health import Health, load_health
from diagnosis.loading.logs import load_throws
from diagnosis.reference_throws import health_from_reference
from diagnosis.verdict import Diagnosis
from machine.errors import UsageError
from sim_twin.child_processes import one_blas_thread
from sim_twin.twin.profile import load_profile

Method = Callable[..., Diagnosis]
"""Takes a loaded set and the machine's profile; the diagnosis also takes the machine's health."""
DIAGNOSE: Final = "diagnose"
METHODS: Final[dict[str, Method]] = {
    DIAGNOSE: diagnose_throws,
    "largest_z": largest_z,
    "evolution": evolution,
    "lag_rmse": lag_rmse,
}
"""What can be run: the diagnosis and the baselines."""
Progress = Callable[[int, int], None]


def read_manifest(folder: Path) -> dict[str, Any]:
    """The list of sets of a challenge.

    Raises:
        UsageError: the folder is no challenge.
    """
    path = folder / MANIFEST
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
        manifest["sets"] = [str(name) for name in manifest["sets"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UsageError(
            f"{folder} is no challenge ({error}); make one with `downrange challenge make`"
        ) from error
    return manifest


def run_challenge(
    folder: Path,
    out: Path,
    *,
    method: str = DIAGNOSE,
    jobs: int = 1,
    limit: int | None = None,
    progress: Progress | None = None,
) -> int:
    """Diagnose every set that `out` has no answer for yet; returns how many were done now.

    Args:
        folder: of the challenge.
        out: answers; written after every set, so that an interrupted run goes on where it stopped.
        method: one of `METHODS`.
        jobs: sets diagnosed side by side.
        limit: only the first so many sets.
        progress: called with the sets answered and the sets in all.

    Raises:
        UsageError: not a challenge, no such method, or answers to something else.
    """
    if method not in METHODS:
        raise UsageError(f"--method {method}: use one of {', '.join(METHODS)}")
    manifest = read_manifest(folder)
    sets: list[str] = manifest["sets"][:limit]
    answers = _open_answers(out, method, str(manifest["sealed_sha256"]))
    done: dict[str, Any] = answers["sets"]
    waiting = [name for name in sets if name not in done]
    if progress is not None:
        progress(len(sets) - len(waiting), len(sets))
    if not waiting:
        return 0
    tasks = [(folder / name, method, jobs == 1) for name in waiting]
    for name, found in spread(tasks, answer, jobs):
        done[name] = found
        _write(out, answers)
        if progress is not None:
            progress(sum(name in done for name in sets), len(sets))
    return len(waiting)


def answer(
    folder: Path,
    method: str,
    is_alone: bool = False,
) -> tuple[str, dict[str, Any]]:
    """Diagnose one set, named by its folder; an error of the program is recorded as a wrong answer."""
    started = perf_counter()
    try:
        loaded = load_throws([folder])
        profile = load_profile(folder / PROFILE_NAME)
        healthy = folder.parent / REFERENCE / profile.machine_id
        more = {"is_alone": is_alone} if method == DIAGNOSE else {}
        if method == DIAGNOSE and healthy.is_dir():
            found = METHODS[method](loaded, profile, health=_reference_health(healthy), **more)
        else:
            found = METHODS[method](loaded, profile, **more)
        said: dict[str, Any] = found.model_dump(mode="json", exclude={"plots"})
        said["evidence"] = _small(said["evidence"])
    except Exception as error:  # one failing set must not end the run
        said = {"error": f"{type(error).__name__}: {error}"}
    # Of the whole process so far, in KiB on Linux.
    memory_mib = getrusage(RUSAGE_SELF).ru_maxrss / 1024.0
    return folder.name, {
        "seconds": round(perf_counter() - started, 2),
        "memory_mib": round(memory_mib),
        "said": said,
    }


@cache
def _reference_health(reference: Path) -> Health:
    """Noise model of a machine from its healthy throws; cached, because many sets are of one machine."""
    profile = load_profile(reference / PROFILE_NAME)
    with one_blas_thread():
        return health_from_reference(load_throws([reference]), profile, load_health())


def _small(evidence: dict[str, Any]) -> dict[str, Any]:
    """Evidence without the clock audits, which would be most of the file."""
    return {name: value for name, value in evidence.items() if name not in ("clocks", "rates_hz")}


def _open_answers(path: Path, method: str, sealed_sha256: str) -> dict[str, Any]:
    fresh: dict[str, Any] = {
        "schema_version": 1,
        "method": method,
        "sealed_sha256": sealed_sha256,
        "sets": {},
    }
    if not path.is_file():
        return fresh
    try:
        kept: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise UsageError(f"{path} holds no answers ({error}); give another file") from error
    if {name: kept.get(name) for name in fresh if name != "sets"} != {
        name: value for name, value in fresh.items() if name != "sets"
    }:
        raise UsageError(
            f"{path} answers another challenge or with another method; give a new file"
        )
    return kept


def _write(path: Path, answers: dict[str, Any]) -> None:
    part = path.with_suffix(path.suffix + ".part")
    part.write_text(json.dumps(answers, indent=1) + "\n", encoding="utf-8")
    part.replace(path)


def answered(paths: Sequence[Path]) -> list[dict[str, Any]]:
    """Files of answers.

    Raises:
        UsageError: one is missing or broken.
    """
    found: list[dict[str, Any]] = []
    for path in paths:
        try:
            document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
            _ = document["sets"], document["method"], document["sealed_sha256"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise UsageError(
                f"{path} holds no answers ({error}); make them with `downrange challenge run`"
            ) from error
        found.append(document)
    return found
