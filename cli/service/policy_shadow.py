"""`downrange policy shadow`: what a version would have done in recorded throws. Nothing moves."""

from collections.abc import Sequence
from pathlib import Path

from evaluation.shadow.results import (
    PredictedThrow,
    ShadowMisses,
    ShadowReport,
    ShadowThrow,
    shadow_figures,
)
from evaluation.shadow.shadow import shadow
from machine.errors import DownrangeError, LogError, UsageError
from machine.policy_card import CARD_FILE, load_card
from machine.spec import MachineSpec, load_spec
from runtime.control.policy import PolicyRunner
from runtime.records.log_reader import read_throw_log
from runtime.records.throw_log import ThrowLog


def shadow_of(folder: Path, logs: Sequence[Path], policies: Path) -> ShadowReport:
    """Run the version of a folder over throw logs.

    Args:
        folder: the version.
        logs: throw logs (MCAP), or folders of them.
        policies: folder of policy versions, where those that flew are looked for.

    Raises:
        UsageError: a path that holds no log, or a log that cannot be read.
        LogError: no throw can be used.
        PolicyError: the version cannot be loaded.
    """
    spec = load_spec()
    candidate = PolicyRunner(folder, spec)
    thrown = _read(logs)
    flew = {str(log.metadata.get("policy_sha256")) for log in thrown}
    return shadow(candidate, thrown, spec, _runners(policies, flew, spec))


def _read(paths: Sequence[Path]) -> list[ThrowLog]:
    files: list[Path] = []
    for path in paths:
        if not path.exists():
            raise UsageError(f"{path} does not exist; give throw logs (.mcap) or folders of them")
        inside = sorted(path.rglob("*.mcap")) if path.is_dir() else [path]
        if not inside:
            raise UsageError(f"{path} holds no throw log (*.mcap)")
        files += inside
    try:
        return [read_throw_log(path) for path in files]
    except LogError as error:
        raise UsageError(str(error)) from error


def _runners(policies: Path, wanted: set[str], spec: MachineSpec) -> dict[str, PolicyRunner]:
    """Those of the wanted versions whose files are in a folder of versions."""
    found: dict[str, PolicyRunner] = {}
    for card_path in sorted(policies.glob(f"*/{CARD_FILE}")):
        try:
            card = load_card(card_path.parent)
            if card.policy_sha256 in wanted:
                found[card.policy_sha256] = PolicyRunner(card_path.parent, spec)
        except DownrangeError:
            continue  # a broken folder beside the one that is asked for
    return found


def shadow_lines(report: ShadowReport) -> list[str]:
    """The report for a terminal."""
    lines = [
        f"{report.policy_id} over {len(report.throws)} {report.mode.value} throws of "
        + ", ".join(report.machine_ids)
    ]
    if report.unregistered_ids:
        names = ", ".join(report.unregistered_ids)
        lines.append(f"not registered on {names}: the mean miss there is that of the bare network")
    lines.append(
        f"{'throw':<28} {'target':>8} {'velocity':>8}  {'let go, s':>17}  {'miss in the twin, m':>36}"
    )
    lines.append(
        f"{'':<28} {'m':>8} {'rms':>8}  {'flown':>8} {'shadow':>8}  {'flown':>17}  {'shadow':>17}"
    )
    lines += [_line(throw) for throw in report.throws]
    for throw_id, reason in report.left_out:
        lines.append(f"left out {throw_id}: {reason}")
    figures = shadow_figures(report)
    return [*lines, _summary("flown", figures.flown), _summary("shadow", figures.candidate)]


def _line(throw: ShadowThrow) -> str:
    range_m = (throw.target.x_m**2 + throw.target.y_m**2) ** 0.5
    shown = "later" if throw.shown_release_s is None else f"{throw.shown_release_s:.2f}"
    flown = "-" if throw.flown_release_s is None else f"{throw.flown_release_s:.2f}"
    return (
        f"{throw.throw_id:<28} {range_m:>8.2f} {throw.action_difference_rms_ratio:>8.2f}  "
        f"{flown:>8} {shown:>8}  {_miss(throw.flown):>17}  {_miss(throw.candidate):>17}"
    )


def _miss(found: PredictedThrow | None) -> str:
    if found is None:
        return "-"
    if found.downrange_error_m is None or found.crossrange_error_m is None:
        return found.outcome.value
    return f"{found.downrange_error_m:+.2f}, {found.crossrange_error_m:+.2f}"


def _summary(name: str, misses: ShadowMisses) -> str:
    if misses.throw_count == 0:
        return f"{name}: the files of the version that flew are not at hand"
    if misses.mean_downrange_m is None or misses.mean_crossrange_m is None:
        return f"{name}: none of {misses.throw_count} lands in the twin"
    return (
        f"{name}: {misses.landed_count} of {misses.throw_count} land in the twin, mean miss "
        f"{misses.mean_downrange_m:+.3f} m downrange, {misses.mean_crossrange_m:+.3f} m crossrange"
    )
