"""What the documents say exists does exist."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

from cli.main import VERBS

ROOT = Path(__file__).parents[2]
PACKAGES = ("machine", "runtime", "sim_twin", "training", "diagnosis", "challenge", "server", "cli")
DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
SYMBOL = re.compile(r"`([\w./-]+\.(?:py|tsx?)) :: ([\w.]+)`")
LINK = re.compile(r"\]\((?!https?:|#|mailto:)([^)#]+)[^)]*\)")


def python_files() -> list[Path]:
    return [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


def symbols_of(path: Path) -> set[str]:
    """Names defined in a file: functions, classes, methods as Class.method, exported TypeScript names."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        return set(re.findall(r"\b(?:function|const|class|type|interface)\s+(\w+)", text))
    names: set[str] = set()
    for node in ast.parse(text).body:
        if isinstance(node, ast.ClassDef):
            names.add(node.name)
            names |= {
                f"{node.name}.{item.name}"
                for item in node.body
                if isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef)
            }
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            names.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names |= {target.id for target in targets if isinstance(target, ast.Name)}
    return names


def named_symbols() -> list[tuple[str, str, str]]:
    return [
        (document.name, path, symbol)
        for document in DOCUMENTS
        for path, symbol in SYMBOL.findall(document.read_text(encoding="utf-8"))
    ]


def test_the_walk_of_a_throw_names_its_symbols():
    assert len([row for row in named_symbols() if row[0] == "walk_a_throw.md"]) >= 10


@pytest.mark.parametrize(("document", "path", "symbol"), named_symbols())
def test_every_symbol_named_in_a_document_exists(document, path, symbol):
    assert (ROOT / path).is_file(), f"{document} names {path}, which does not exist"
    assert symbol in symbols_of(ROOT / path), f"{document} names {path} :: {symbol}"


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_links_lead_somewhere(document):
    for target in LINK.findall(document.read_text(encoding="utf-8")):
        assert (document.parent / target).exists(), f"{document.name} links to {target}"


def test_every_verb_is_documented():
    text = (ROOT / "docs/command_line.md").read_text(encoding="utf-8")
    assert [verb for verb in VERBS if f"## {verb}" not in text] == []


def test_every_make_target_is_in_the_readme():
    targets = re.findall(r"^([a-z0-9]+):.*## ", (ROOT / "Makefile").read_text(), flags=re.M)
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert [target for target in targets if f"make {target}" not in readme] == []


@pytest.mark.parametrize("path", python_files(), ids=lambda path: str(path.relative_to(ROOT)))
def test_files_and_functions_stay_readable(path):
    text = path.read_text(encoding="utf-8")
    assert text.count("\n") <= 500, f"{path.name} has more than 500 lines: split it"
    long = [
        f"{node.name} ({node.end_lineno - node.lineno + 1})"
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and (node.end_lineno or 0) - node.lineno + 1 > 80
    ]
    assert not long, f"functions of more than 80 lines: {long}"


def test_importing_a_module_does_nothing_else():
    modules = [
        ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for path in python_files()
        if path.name != "__init__.py"
    ]
    script = (
        "import importlib, os, sys, threading\n"
        "before = dict(os.environ)\n"
        f"for name in {modules!r}: importlib.import_module(name)\n"
        "assert threading.active_count() == 1, threading.enumerate()\n"
        "changed = {k for k in os.environ if before.get(k) != os.environ[k]}\n"
        # OpenMP's and JAX's own doing.
        "foreign = ('KMP_', 'TF_CPP_', 'TPU_')\n"
        "assert not {k for k in changed if not k.startswith(foreign)}, changed\n"
    )
    answer = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert answer.returncode == 0, answer.stderr[-2000:]
    assert answer.stdout == ""
