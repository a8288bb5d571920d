"""Symbols, files, verbs and targets that documents name exist, and those that exist are documented."""

import ast
import re
from pathlib import Path

from cli.main import VERBS
from server.settings import Settings, variable_name
from tests.source_tree import ROOT, documents, shown

SYMBOL = re.compile(r"`([\w./-]+\.(?:py|tsx?)) :: ([\w.]+)`")
LINK = re.compile(r"\]\((?!https?:|#|mailto:)([^)#]+)[^)]*\)")


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


def named_symbols(document: Path) -> list[tuple[str, str]]:
    """Pairs of file and symbol that a document names."""
    return SYMBOL.findall(document.read_text(encoding="utf-8"))


def test_the_walk_of_a_throw_names_its_symbols():
    assert len(named_symbols(ROOT / "docs/walk_a_throw.md")) >= 10


def test_symbols_named_in_documents_exist():
    wrong = [
        f"{shown(document)}: {path} :: {symbol}"
        for document in documents()
        for path, symbol in named_symbols(document)
        if not (ROOT / path).is_file() or symbol not in symbols_of(ROOT / path)
    ]
    assert wrong == []


def test_links_in_documents_lead_to_files():
    wrong = [
        f"{shown(document)}: {target}"
        for document in documents()
        for target in LINK.findall(document.read_text(encoding="utf-8"))
        if not (document.parent / target).exists()
    ]
    assert wrong == []


def test_every_verb_is_documented():
    text = (ROOT / "docs/command_line.md").read_text(encoding="utf-8")
    assert [verb for verb in VERBS if f"## {verb}" not in text] == []


def test_every_make_target_is_in_the_readme():
    targets = re.findall(r"^([a-z0-9-]+):.*## ", (ROOT / "Makefile").read_text(), flags=re.M)
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert [target for target in targets if f"make {target}" not in readme] == []


def test_documents_stay_short():
    """A page has at most 1500 words, all pages 25 000; the change log at most 120 lines."""
    words = {path: len(path.read_text(encoding="utf-8").split()) for path in documents()}
    pages = {path: count for path, count in words.items() if ROOT / "docs" in path.parents}
    too_long = [f"{shown(path)}: {count}" for path, count in pages.items() if count > 1500]
    assert too_long == []
    assert sum(pages.values()) <= 25_000
    assert (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").count("\n") <= 120


def test_every_setting_of_the_server_is_documented():
    text = (ROOT / "docs/operations.md").read_text(encoding="utf-8")
    names = [variable_name(field) for field in Settings.model_fields]
    assert [name for name in names if f"`{name}`" not in text] == []


def test_the_glossary_is_short():
    text = (ROOT / "docs/glossary.md").read_text(encoding="utf-8")
    terms = [line for line in text.splitlines() if line.startswith("|")][2:]
    assert len(terms) <= 40
