"""Models of healthy machines that were estimated before, kept in files by what they were estimated from."""

import hashlib
import json
import os
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import fields
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, NamedTuple
from urllib.parse import quote

import numpy as np
from pydantic import BaseModel

from diagnosis.healthy.filters import HealthyModel
from diagnosis.healthy.health import Health
from diagnosis.healthy.noise import NoiseModel
from diagnosis.loading.throw_data import ThrowData
from sim_twin.twin.profile import TwinProfile

KEPT_COUNT: Final = 4
"""Files a folder holds: one machine's profiles and reference throws of late."""
PACKAGES: Final = ("machine", "runtime", "sim_twin", "diagnosis")
"""Packages whose code decides on a model, but for `UNREAD_FOLDERS`."""
UNREAD_FOLDERS: Final = {"report", "single_stage", "tables"}
"""Folders of code that only words an answer, or reads one stage's tables."""
LIBRARIES: Final = ("numpy", "scipy", "mujoco-core")
UNREAD_FIELDS: Final = {"path", "notes"}
"""Fields of a throw that say nothing of its motion."""


class KeptHealth(NamedTuple):
    """A model of a healthy machine, and when it was estimated."""

    health: Health
    estimated_utc: str
    """YYYY-MM-DDTHH:MM:SSZ"""


class HealthStore:
    """One folder with a file for every model, named by its key (`health_key`).

    A file is written beside its name and renamed, so that several processes may read and write one folder. It
    holds the hash of its content: a damaged file counts as none. A folder that cannot be written keeps
    nothing, and every model is estimated anew.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def find(self, key: str) -> KeptHealth | None:
        """The model that was kept under a key; None where there is none."""
        path = self._folder / f"{key}.json"
        try:
            digest, _, text = path.read_text(encoding="utf-8").partition("\n")
            if digest != _sha256(text):
                return None
            found = _parsed(text)
            # The files used last stay.
            os.utime(path)
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return found

    def keep(self, key: str, health: Health) -> None:
        """Keep a model, if its file holds it to the last bit; drop what was not used for longest."""
        at = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        text = _text(health, at)
        try:
            if _text(_parsed(text).health, at) != text:
                return
        except ValueError:
            return
        with suppress(OSError):
            self._folder.mkdir(parents=True, exist_ok=True)
            self._write(key, f"{_sha256(text)}\n{text}")
            self._drop_old()

    def _write(self, key: str, content: str) -> None:
        handle, scratch = tempfile.mkstemp(prefix=".", suffix=".part", dir=self._folder)
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                file.write(content)
            Path(scratch).replace(self._folder / f"{key}.json")
        except OSError:
            Path(scratch).unlink(missing_ok=True)
            raise

    def _drop_old(self) -> None:
        """Also files of a process that ended while it wrote."""
        for pattern in ("*.json", ".*.part"):
            by_use = sorted(self._folder.glob(pattern), key=_used_s)
            for path in by_use[:-KEPT_COUNT]:
                path.unlink(missing_ok=True)


def health_store(machines: Path, machine_id: str) -> HealthStore:
    """Where a folder of machines keeps the models of one: ``MACHINE.health/``."""
    return HealthStore(machines / f"{quote(machine_id, safe='')}.health")


def health_key(reference: Sequence[ThrowData], profile: TwinProfile, health: Health) -> str:
    """Hash of everything that a model of a healthy machine is estimated from.

    Args:
        reference: throws of the machine while it was healthy, in their order.
        profile: of the twin that they are compared with.
        health: model of the type.
    """
    digest = hashlib.sha256(_code().encode())
    digest.update(_text(health, "").encode())
    digest.update(profile.model_dump_json().encode())
    for throw in reference:
        for field in fields(throw):
            if field.name not in UNREAD_FIELDS:
                digest.update(f"\n{field.name} ".encode())
                digest.update(_bytes(getattr(throw, field.name)))
    return digest.hexdigest()


def _bytes(value: Any) -> bytes:
    if isinstance(value, np.ndarray):
        return f"{value.dtype.str}{value.shape}".encode() + np.ascontiguousarray(value).tobytes()
    if isinstance(value, BaseModel):
        return value.model_dump_json().encode()
    return repr(value).encode()


def _text(health: Health, estimated_utc: str) -> str:
    own = None if health.profile is None else health.profile.model_dump(mode="json")
    content = {
        "estimated_utc": estimated_utc,
        "filters": health.filters.model_dump(mode="json"),
        "noise": health.noise.model_dump(mode="json"),
        "profile": own,
        "replay_gap_m": dict(health.replay_gap_m),
    }
    return json.dumps(content)


def _parsed(text: str) -> KeptHealth:
    content = json.loads(text)
    own = content["profile"]
    return KeptHealth(
        Health(
            HealthyModel.model_validate(content["filters"]),
            NoiseModel.model_validate(content["noise"]),
            None if own is None else TwinProfile.model_validate(own),
            content["replay_gap_m"],
        ),
        content["estimated_utc"],
    )


@cache
def _code() -> str:
    """Hash of the code and data of the packages, and of the versions of the libraries."""
    digest = hashlib.sha256(" ".join(version(name) for name in LIBRARIES).encode())
    root = Path(__file__).parents[2]
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*")):
            if path.suffix in (".py", ".json") and path.parent.name not in UNREAD_FOLDERS:
                digest.update(f"{path.relative_to(root)}\n".encode())
                digest.update(path.read_bytes())
    return digest.hexdigest()


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _used_s(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0
