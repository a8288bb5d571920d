"""Parts of a validation: one version thrown with one machine; where it runs does not change the result."""

import tempfile
from collections.abc import Mapping
from pathlib import Path
from time import perf_counter
from typing import Final, NamedTuple

import numpy as np

from evaluation.campaign_registration import is_registered, open_registered
from evaluation.campaigns import Campaign, CampaignOptions, throw_campaign
from evaluation.measures import Failure, target_row
from evaluation.unit_accuracy import NOMINAL_UNIT
from evaluation.validation.results import Latency, UnitLandings, ValidationPlan
from machine.conventions import Array
from machine.errors import PolicyError
from machine.policy_card import CARD_FILE, GOLDEN_FILE, POLICY_FILE, read_policy
from machine.spec import load_spec
from runtime.control.policy import PolicyRunner
from sim_twin.child_processes import one_blas_thread
from sim_twin.throws.campaign import ThrowOutcome, ThrowResult
from sim_twin.throws.throw_logs import FailureRecorder, LogContext

MAX_LOG_COUNT: Final = 5
"""Logs of failed throws that are kept of one version with one machine."""
REPEATED_THROW_COUNT: Final = 5
"""Throws at each target that are thrown twice with the same seed."""
LATENCY_RUN_COUNT: Final = 2000
WARM_RUN_COUNT: Final = 100


class VersionFiles(NamedTuple):
    """A policy version as it travels to another process or computer."""

    policy_id: str
    policy_sha256: str
    files: Mapping[str, bytes]
    """By name."""

    def write(self, root: Path) -> Path:
        """Write the files into a folder of the version's name."""
        folder = root / self.policy_id
        folder.mkdir()
        for name, content in self.files.items():
            (folder / name).write_bytes(content)
        return folder


class ValidationPart(NamedTuple):
    """One version with one machine."""

    version: VersionFiles
    plan: ValidationPlan
    unit_seed: int

    @property
    def name(self) -> str:
        """Name within its validation."""
        return f"{self.version.policy_sha256[:16]}/{self.unit_seed}"


class PartAnswer(NamedTuple):
    """What a part found, and the logs of throws that failed, by file name."""

    landings: UnitLandings
    logs: Mapping[str, bytes]


def read_version(folder: Path, policy_sha256: str) -> VersionFiles:
    """Read a version's files once.

    Raises:
        PolicyError: they cannot be read, or are another version's.
    """
    found = read_policy(folder)
    if found.card.policy_sha256 != policy_sha256:
        raise PolicyError(f"{folder} holds another version than {policy_sha256[:12]}")
    files = {POLICY_FILE: found.policy, CARD_FILE: found.text}
    if found.golden is not None:
        files[GOLDEN_FILE] = found.golden
    return VersionFiles(found.card.policy_id, policy_sha256, files)


def throw_part(part: ValidationPart) -> PartAnswer:
    """Calibrate and register the machine, throw at every target, and repeat some throws."""
    plan, unit_seed = part.plan, part.unit_seed
    throws = plan.throws_of(unit_seed)
    with tempfile.TemporaryDirectory(prefix="downrange-validation-") as name, one_blas_thread():
        root = Path(name)
        options = CampaignOptions(
            plant=plan.plant,
            targets=",".join(f"{range_m!r}" for range_m in plan.ranges_m),
            throws=throws,
            seed=plan.seed,
            unit_seed=unit_seed,
            policies=root,
            policy=part.version.write(root),
            calibration=None,
            profile=None,
        )
        campaign, note = open_registered(options, plan.mode.value, "")
        context = LogContext(
            machine_id=f"{plan.plant}-{unit_seed}",
            throw_prefix=f"{part.version.policy_id}-u{unit_seed}-s{plan.seed}",
            twin_profile_version_count=0,
            out_dir=root / "logs",
        )
        recorder = FailureRecorder(campaign.params, context, MAX_LOG_COUNT)
        (root / "logs").mkdir()
        results = throw_campaign(campaign, throws, plan.seed, recorder)
        logs = {stored.path.name: stored.path.read_bytes() for stored in recorder.stored}
        return PartAnswer(
            UnitLandings(
                unit_seed=unit_seed,
                is_registered=is_registered(campaign),
                registration_note=note,
                targets=tuple(
                    target_row(r, part) for r, part in zip(plan.ranges_m, results, strict=True)
                ),
                failures=tuple(_failures(plan, results, list(logs))),
                is_repeatable=_repeats(campaign, throws, plan.seed)
                if unit_seed == NOMINAL_UNIT
                else None,
            ),
            logs,
        )


def _failures(
    plan: ValidationPlan, results: list[list[ThrowResult]], logs: list[str]
) -> list[Failure]:
    """Throws that did not land, in their order; the logs' names end with the number of the throw."""
    by_number = {int(Path(name).stem.rsplit("-", 1)[-1]): name for name in logs}
    thrown = [
        (range_m, result)
        for range_m, part in zip(plan.ranges_m, results, strict=True)
        for result in part
    ]
    return [
        Failure(
            range_m=range_m,
            number=number,
            outcome=result.outcome.value,
            after_release=bool(np.isfinite(result.throw_duration_s)),
            log=by_number.get(number),
        )
        for number, (range_m, result) in enumerate(thrown)
        if result.outcome is not ThrowOutcome.LANDED
    ]


def _repeats(campaign: Campaign, throws: int, seed: int) -> bool:
    """Whether two campaigns of the same seed give the same landings, bit for bit."""
    count = min(throws, REPEATED_THROW_COUNT)
    # As text: a throw that did not land has errors that are no numbers and equal nothing.
    first, second = (repr(throw_campaign(campaign, count, seed)) for _ in range(2))
    return first == second


def measure_latency(version: VersionFiles) -> Latency:
    """Time single runs of the network, one observation each, on this computer.

    Raises:
        PolicyError: the version cannot be loaded.
    """
    with tempfile.TemporaryDirectory(prefix="downrange-validation-") as name:
        runner = PolicyRunner(version.write(Path(name)), load_spec())
    observation = np.zeros((1, len(runner.card.observation_names)))
    seconds: list[float] = []
    for _ in range(WARM_RUN_COUNT + LATENCY_RUN_COUNT):
        began_s = perf_counter()
        runner.act(observation)
        seconds.append(perf_counter() - began_s)
    times: Array = np.array(seconds[WARM_RUN_COUNT:])
    p50_s, p99_s = np.percentile(times, (50, 99))
    return Latency(p50_s=float(p50_s), p99_s=float(p99_s), run_count=LATENCY_RUN_COUNT)
