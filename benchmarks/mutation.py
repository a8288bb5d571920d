"""Changes the safety code in small ways, one at a time, and lists the changes that no test notices.

Operators of comparison, arithmetic and logic are exchanged, numbers changed, conditions negated. Each changed
module is written over the original in a copy of the tree; the tests of that module run against it, in a
process forked from this one, which has the libraries loaded.

    python -m benchmarks.mutation [--module runtime/throw/freshness.py] [--limit 40] [--seed 1]
"""

import argparse
import ast
import copy
import importlib
import json
import multiprocessing
import os
import random
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
MODULES = {
    "runtime/control/safety.py": [
        "tests/runtime/control/test_safety.py",
        "tests/runtime/control/test_safety_permission.py",
    ],
    "runtime/guard/drive_envelope.py": ["tests/runtime/guard/test_drive_envelope.py"],
    "runtime/guard/imu_plausibility.py": ["tests/runtime/guard/test_imu_plausibility.py"],
    "runtime/guard/plausibility.py": ["tests/runtime/guard/test_plausibility.py"],
    "runtime/guard/release_window.py": ["tests/runtime/guard/test_release_window.py"],
    "runtime/throw/freshness.py": ["tests/runtime/throw/test_freshness.py"],
    "runtime/throw/transitions.py": ["tests/runtime/throw"],
    "runtime/throw/states.py": ["tests/runtime/throw"],
    "runtime/throw/command_rules.py": ["tests/runtime/throw"],
    "runtime/throw/checks.py": ["tests/runtime/throw/test_checks.py"],
    "runtime/throw/facts.py": ["tests/runtime/throw/test_throw_facts.py"],
}
LIBRARIES = ("hypothesis", "numpy", "onnxruntime", "pydantic", "scipy.stats")
"""Loaded once. Nothing of the tree itself: each process loads the changed one."""
TIMEOUT_S = 120.0
"""A change that lets the tests run longer is noticed."""
SWAPS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.And: ast.Or,
    ast.Or: ast.And,
}


def mutants(tree: ast.Module) -> list[tuple[int, str, ast.Module]]:
    """Line, description and tree of every single change."""
    found: list[tuple[int, str, ast.Module]] = []
    nodes = list(ast.walk(tree))
    for index, node in enumerate(nodes):
        for text, change in _changes(node):
            changed = copy.deepcopy(tree)
            twin = list(ast.walk(changed))[index]
            change(twin)
            found.append((getattr(node, "lineno", 0), text, ast.fix_missing_locations(changed)))
    return found


def _changes(node: ast.AST) -> Iterator[tuple[str, Callable[[Any], None]]]:
    """Descriptions of the changes of one node, and what makes each in a copy of it."""
    if isinstance(node, ast.Compare) and type(node.ops[0]) in SWAPS:
        new = SWAPS[type(node.ops[0])]
        yield f"{ast.unparse(node)}: {new.__name__}", lambda n: n.ops.__setitem__(0, new())
    if isinstance(node, ast.BinOp | ast.BoolOp) and type(node.op) in SWAPS and not _is_type(node):
        new_op = SWAPS[type(node.op)]
        yield f"{ast.unparse(node)}: {new_op.__name__}", lambda n: setattr(n, "op", new_op())
    if isinstance(node, ast.If | ast.IfExp):
        test = f"not ({ast.unparse(node.test)})"
        yield test, lambda n: setattr(n, "test", ast.UnaryOp(ast.Not(), n.test))
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        yield f"{node.value} + 1", lambda n: setattr(n, "value", n.value + 1)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Invert | ast.Not):
        twice = type(node.op)
        yield (
            f"without {ast.unparse(node)}",
            lambda n: setattr(n, "operand", ast.UnaryOp(twice(), n.operand)),
        )


def _is_type(node: ast.BinOp | ast.BoolOp) -> bool:
    """Unions in annotations are no arithmetic."""
    return isinstance(node, ast.BinOp) and "None" in ast.unparse(node)


def survives(folder: Path, module: str, source: str, tests: list[str]) -> bool:
    """Whether no test notices this source."""
    (folder / module).write_text(source, encoding="utf-8")
    process = multiprocessing.get_context("fork").Process(target=_test, args=(folder, tests))
    process.start()
    process.join(TIMEOUT_S)
    if process.is_alive():
        process.kill()
        process.join()
    return process.exitcode == 0


def _test(folder: Path, tests: list[str]) -> None:
    os.chdir(folder)
    sys.path[:0] = [str(folder)]
    sys.dont_write_bytecode = True
    output = os.open(os.devnull, os.O_WRONLY)
    os.dup2(output, 1)
    os.dup2(output, 2)
    quiet = ["-x", "-q", "--no-header", "-p", "no:cacheprovider"]
    # Of the libraries that are loaded already.
    quiet += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]
    code = pytest.main([*quiet, *tests])
    os._exit(int(code))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--module", choices=sorted(MODULES), default=None)
    parser.add_argument("--limit", type=int, default=10_000, help="changes a module, drawn by seed")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, default=None)
    given = parser.parse_args()
    report: dict[str, dict[str, object]] = {}
    for library in LIBRARIES:
        importlib.import_module(library)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for part in ("machine", "runtime", "sim_twin", "tests", "pyproject.toml", "policies"):
            source = ROOT / part
            (shutil.copytree if source.is_dir() else shutil.copy)(source, folder / part)
        for module, tests in MODULES.items():
            if given.module not in (None, module):
                continue
            text = (ROOT / module).read_text(encoding="utf-8")
            if not survives(folder, module, text, tests):
                sys.exit(f"{module}: the tests fail on the unchanged module: {tests}")
            changes = mutants(ast.parse(text))
            random.Random(given.seed).shuffle(changes)
            changes = changes[: given.limit]
            left: list[str] = []
            for line, what, tree in changes:
                if survives(folder, module, ast.unparse(tree), tests):
                    left.append(f"{module}:{line} {what}")
                    print(f"    {left[-1]}", flush=True)
            (folder / module).write_text(text, encoding="utf-8")
            print(f"{module}: {len(left)} of {len(changes)} changes unnoticed", flush=True)
            report[module] = {"changes": len(changes), "unnoticed": sorted(left)}
    if given.json is not None:
        given.json.write_text(json.dumps(report, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
