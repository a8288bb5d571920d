"""The runtime lives on a machine's computer: it installs and imports with its own few packages alone."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
HEAVY = ("mujoco", "scipy", "fastapi", "sqlalchemy", "viser", "jax", "matplotlib", "uvicorn")
IMPORT_ALL = f"""
import importlib, importlib.util, pkgutil
for package in ("machine", "runtime"):
    for module in pkgutil.walk_packages(importlib.import_module(package).__path__, package + "."):
        importlib.import_module(module.name)
importlib.import_module("cli.machine")
present = [name for name in {HEAVY!r} if importlib.util.find_spec(name)]
assert not present, f"not a slim environment: {{present}}"
"""


def find_uv() -> str | None:
    beside = ROOT / ".tools/bin/uv"
    return str(beside) if beside.exists() else shutil.which("uv")


@pytest.mark.long
@pytest.mark.timeout(600)
def test_runtime_installs_and_imports_alone(tmp_path):
    uv = find_uv()
    assert uv, "uv not found: run `make setup`, which puts it into .tools"
    environment = {
        **os.environ,
        "UV_PROJECT_ENVIRONMENT": str(tmp_path / "venv"),
        "UV_PYTHON": sys.executable,
        "UV_PYTHON_DOWNLOADS": "never",
    }
    environment.pop("VIRTUAL_ENV", None)
    subprocess.run(
        [uv, "sync", "--frozen", "--no-dev", "--quiet"], cwd=ROOT, env=environment, check=True
    )
    python = tmp_path / "venv/bin/python"
    subprocess.run([python, "-W", "error", "-c", IMPORT_ALL], cwd=tmp_path, check=True)
    answer = subprocess.run(
        [tmp_path / "venv/bin/downrange", "machine", "--help"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert answer.returncode == 0, answer.stderr
    assert "--driver" in answer.stdout
