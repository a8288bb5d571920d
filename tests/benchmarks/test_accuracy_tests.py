"""The tests of `make accuracy`, too slow for every commit, can still be run."""

from importlib import import_module
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks" / "accuracy"


def test_every_file_of_accuracy_tests_imports() -> None:
    files = sorted(FOLDER.glob("test_*.py"))
    assert files
    for file in files:
        import_module(f"benchmarks.accuracy.{file.stem}")
