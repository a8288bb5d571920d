"""A dossier as one page for people; it needs neither the product nor a network."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from reports.html import render_page
from server.dossier.signed_archive import DossierManifest


@dataclass(frozen=True, slots=True)
class ThrowRecord:
    """One throw as its members and its line of the page say it."""

    throw: dict[str, Any]
    members: tuple[tuple[str, bytes], ...]
    """Names within the throw's folder, and contents."""
    impacts: tuple[dict[str, Any], ...]
    events: tuple[dict[str, Any], ...]
    plan: dict[str, Any] | None

    def summary(self) -> "ThrowRecord":
        """What the page of a period needs."""
        return ThrowRecord(self.throw, (), self.impacts, (), None)


def dossier_page(
    manifest: DossierManifest,
    records: Sequence[ThrowRecord],
    policies: Sequence[dict[str, Any]],
    audit: Sequence[dict[str, Any]],
) -> str:
    """The page.

    Args:
        manifest: without the page itself.
        records: of the throws; events and plan are shown where there is one throw.
        policies: id, sha256, approvals and steps of each version.
        audit: the first rows.
    """
    return render_page(
        Path(__file__).parent,
        "dossier.html.j2",
        manifest=manifest,
        records=records,
        alone=records[0] if manifest.throw_id is not None else None,
        policies=policies,
        audit=[{**row, "detail": json.loads(row["detail_json"])} for row in audit],
    )
