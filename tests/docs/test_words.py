"""Words of a private language stay out of code, documents and console.

Standard terms of the field replace them: see docs/glossary.md.
"""

import re
import subprocess

from tests.source_tree import ROOT, packages

PRIVATE = (
    r"\b[Tt]old\b|_told|told_",
    r"[Ss]tranger",
    r"[Uu]nheard",
    r"\b[Bb]y eye\b",
    r"\b[Aa]t home\b",
    r"[Ll]eftover(?!_sd\b)",  # leftover_sd is a field of stored results
    r"\b[Ss]uspects\b",
    r"\b[Ss]trides\b",
    r"\b[Pp]romised\b",
    r"two_levels",
    r"PolicyShelf",
    r"LoginBrake",
    r"WaitingRoom",
    r"viewer_door",
    r"ImpactBoard",
    r"CommandDesk",
)
"""Patterns of words that are gone."""

WHERE = (
    *packages(),
    "benchmarks",
    "scripts",
    "web/src",
    "docs",
    "README.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
)
"""Folders and files that a user or a contributor reads."""


def test_no_private_words():
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--", *WHERE],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split("\0")
    found: list[str] = []
    for name in filter(None, listed):
        path = ROOT / name
        if not path.is_file():
            continue
        try:
            text = f"{name}\n{path.read_text(encoding='utf-8')}"
        except UnicodeDecodeError:
            continue
        for number, line in enumerate(text.split("\n")):
            found += [f"{name}:{number}: {word}" for word in re.findall("|".join(PRIVATE), line)]
    assert found == []
