"""The shape of the source tree: sizes, folders, imports. Each test lists everything that breaks its rule."""

import ast
import subprocess
import sys
from collections import defaultdict
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import grimp
import pytest

from tests.source_tree import ROOT, packages, python_files, shown

MAX_FILE_LINES = 500
MAX_FUNCTION_LINES = 80
MAX_PACKAGE_MODULES = 15
MAX_IMPORT_CHAIN = 12

LONG_CHAINS = {"diagnosis"}
"""Packages whose longest import chain may be longer than `MAX_IMPORT_CHAIN`."""

STARTED_OFTEN = (
    "server.app",
    "server.plans.preview_worker",
    "server.validation.validation_worker",
    "runtime.process.control_process",
)
SLOW_TO_LOAD = ("scipy.stats", "scipy.signal", "jax", "matplotlib")
"""Each takes seconds of processor time; scipy.special has the quantiles."""

Edges = dict[str, set[str]]


@pytest.fixture(scope="module")
def imports() -> Edges:
    """What each module imports of the project: at the top, in functions, for types, by import_module."""
    graph = grimp.build_graph(*packages(), cache_dir=None)
    edges = {name: graph.find_modules_directly_imported_by(name) for name in graph.modules}
    for path in python_files():
        edges[module_name(path)] |= imported_by_name(path) & edges.keys()
    return edges


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported_by_name(path: Path) -> set[str]:
    """Modules that a file imports by a constant string."""
    return {
        argument.value
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call)
        and (
            (isinstance(node.func, ast.Attribute) and node.func.attr == "import_module")
            or (isinstance(node.func, ast.Name) and node.func.id in ("import_module", "__import__"))
        )
        for argument in node.args
        if isinstance(argument, ast.Constant) and isinstance(argument.value, str)
    }


def sorted_out(edges: Edges) -> tuple[list[str], list[str]]:
    """Modules with what they import before them, and the cycles that had to be cut for that."""
    edges = {name: set(targets) for name, targets in edges.items()}
    cycles: list[str] = []
    while True:
        try:
            return list(TopologicalSorter(edges).static_order()), cycles
        except CycleError as error:
            cycle: list[str] = error.args[1]
            cycles.append(" <- ".join(cycle))
            edges[cycle[1]].discard(cycle[0])


def test_modules_import_each_other_in_no_circle(imports: Edges):
    assert sorted_out(imports)[1] == []


def test_folders_import_each_other_in_one_direction(imports: Edges):
    inside = {path.parent.relative_to(ROOT).parts for path in python_files()}
    names = {".".join(parts) for parts in inside if len(parts) == 2}
    folders: Edges = {name: set() for name in names}
    for name, targets in imports.items():
        folder = name.rpartition(".")[0]
        if folder in names:
            folders[folder] |= {target.rpartition(".")[0] for target in targets} & names - {folder}
    assert sorted_out(folders)[1] == []


def test_import_chains_are_short(imports: Edges):
    long: list[str] = []
    for package in set(packages()) - LONG_CHAINS:
        inside = {name for name in imports if name.split(".")[0] == package}
        edges = {name: imports[name] & inside for name in inside}
        chains: dict[str, list[str]] = {}
        for name in sorted_out(edges)[0]:
            longest = max(
                (chains[other] for other in edges[name] if other in chains), default=[], key=len
            )
            chains[name] = [*longest, name]
        longest = max(chains.values(), key=len)
        if len(longest) > MAX_IMPORT_CHAIN:
            long.append(f"{package}: {len(longest)} modules: {' <- '.join(longest)}")
    assert long == []


def test_packages_are_small_and_shallow():
    files: dict[Path, int] = defaultdict(int)
    for path in python_files():
        files[path.parent.relative_to(ROOT)] += path.name != "__init__.py"
    wrong = [
        f"{folder}: {count} modules"
        for folder, count in files.items()
        if count > MAX_PACKAGE_MODULES
    ]
    wrong += [f"{folder}: more than two levels" for folder in files if len(folder.parts) > 2]
    assert wrong == []


def test_files_and_functions_are_short():
    long: list[str] = []
    for path in python_files():
        text = path.read_text(encoding="utf-8")
        if text.count("\n") > MAX_FILE_LINES:
            long.append(f"{shown(path)}: {text.count(chr(10))} lines")
        long += [
            f"{shown(path)} :: {node.name}: {node.end_lineno - node.lineno + 1} lines"
            for node in ast.walk(ast.parse(text))
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
            and (node.end_lineno or 0) - node.lineno + 1 > MAX_FUNCTION_LINES
        ]
    assert long == []


def test_public_classes_have_names_of_their_own():
    places: dict[str, list[str]] = defaultdict(list)
    for path in python_files():
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(shown(path))
    same = {name: files for name, files in places.items() if len(files) > 1}
    assert same == {}


def top_level_imports(path: Path) -> set[str]:
    """Modules, and names that may be modules, that a file imports whenever it is loaded."""
    found: set[str] = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Import):
            found |= {item.name for item in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{item.name}" for item in node.names)}
    return found


def test_processes_that_start_often_load_nothing_slow():
    imported = {module_name(path): top_level_imports(path) for path in python_files()}
    reached: set[str] = set()
    waiting = set(STARTED_OFTEN)
    assert waiting <= imported.keys()
    while waiting:
        reached |= waiting
        waiting = {n for m in waiting for n in imported[m] if n in imported} - reached
    slow = [
        f"{module}: {name}"
        for module in sorted(reached)
        for name in sorted(imported[module])
        if any(name == one or name.startswith(f"{one}.") for one in SLOW_TO_LOAD)
    ]
    assert slow == []


def test_importing_a_module_does_nothing_else():
    modules = [module_name(path) for path in python_files()]
    script = (
        "import importlib, os, sys, threading\n"
        "before = dict(os.environ)\n"
        f"for name in {modules!r}: importlib.import_module(name)\n"
        "assert threading.active_count() == 1, threading.enumerate()\n"
        "changed = {k for k in os.environ if before.get(k) != os.environ[k]}\n"
        # OpenMP and JAX set these themselves.
        "foreign = ('KMP_', 'TF_CPP_', 'TPU_')\n"
        "assert not {k for k in changed if not k.startswith(foreign)}, changed\n"
    )
    answer = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert answer.returncode == 0, answer.stderr[-2000:]
    assert answer.stdout == ""
