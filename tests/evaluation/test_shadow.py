"""Versions over recorded throws: the one that flew is its own shadow, another one differs."""

from dataclasses import replace
from pathlib import Path

import pytest

from evaluation.campaigns import open_campaign
from evaluation.log_campaign import RecordedMachine, record_campaign
from evaluation.shadow.results import shadow_figures
from evaluation.shadow.shadow import shadow
from machine.conventions import Mode
from machine.errors import LogError
from machine.spec import load_spec
from runtime.control.policy import PolicyRunner
from runtime.records.log_reader import read_throw_log
from runtime.records.throw_log import ThrowLog

SPEC = load_spec()
POLICIES = Path("policies")


def runner(name: str) -> PolicyRunner:
    return PolicyRunner(POLICIES / name, SPEC)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[ThrowLog]:
    """Four 2D throws of the twin itself."""
    campaign = open_campaign(
        mode=Mode.PLANAR, plant="twin", targets="7.5,9", throws=2, seed=3, unit_seed=0,
        policies=POLICIES, policy=POLICIES / "m545-2d-v7", calibration=None, profile=None,
    )  # fmt: skip
    machine = RecordedMachine(plant="twin", unit_seed=0, profile=None, machine_id="m9")
    found = record_campaign([campaign], machine, None, 4, 3, tmp_path_factory.mktemp("logs"))
    return [read_throw_log(path) for path in found.paths]


def test_the_version_that_flew_is_its_own_shadow(logs: list[ThrowLog]) -> None:
    flew = runner("m545-2d-v7")
    report = shadow(flew, logs, SPEC, {flew.card.policy_sha256: flew})
    assert len(report.throws) == 4 and report.left_out == ()
    for throw in report.throws:
        assert throw.action_difference_rms_ratio < 1e-6
        assert throw.shown_release_s == throw.flown_release_s is not None
        assert throw.candidate == throw.flown
        # The twin threw them: it lands where the record did, but for scatter.
        assert throw.candidate.downrange_error_m is not None
        assert throw.measured_downrange_error_m is not None
        assert throw.candidate.downrange_error_m == pytest.approx(
            throw.measured_downrange_error_m, abs=0.25
        )


def test_another_version_acts_otherwise(logs: list[ThrowLog]) -> None:
    report = shadow(runner("m545-2d-v6"), logs, SPEC)
    assert all(throw.action_difference_rms_ratio > 0.01 for throw in report.throws)
    assert all(throw.flown is None for throw in report.throws)
    assert report.machine_ids == report.unregistered_ids == ("m9",)


def test_what_cannot_be_shadowed_is_left_out_with_its_reason(logs: list[ThrowLog]) -> None:
    scripted = replace(logs[0], metadata={**logs[0].metadata, "policy_sha256": ""})
    cut = replace(logs[1], policy=logs[1].policy[:2])
    far = {**logs[2].metadata, "target": {"x_m": 30.0, "y_m": 0.0, "z_m": 0.0}}
    version = runner("m545-2d-v6")
    report = shadow(version, [scripted, cut, replace(logs[2], metadata=far), logs[3]], SPEC)
    assert len(report.throws) == 1
    reasons = [reason for _, reason in report.left_out]
    assert ["no policy" in reasons[0], "2 policy steps" in reasons[1], "30.00 m" in reasons[2]] == (
        [True] * 3
    )
    with pytest.raises(LogError, match="throws in 3d"):
        shadow(runner("m545-3d-v7"), logs, SPEC)


def test_throws_of_several_machines_are_told_apart(logs: list[ThrowLog]) -> None:
    version = runner("m545-2d-v6")
    other = replace(logs[0], metadata={**logs[0].metadata, "machine_id": "m8"})
    report = shadow(version, [other, logs[1]], SPEC)
    assert report.machine_ids == ("m8", "m9")
    assert [throw.machine_id for throw in report.throws] == ["m8", "m9"]
    figures = shadow_figures(report)
    assert (figures.candidate.throw_count, figures.flown.throw_count) == (2, 0)
    landed = [one.candidate.downrange_error_m for one in report.throws]
    assert figures.candidate.mean_downrange_m == pytest.approx(sum(filter(None, landed)) / 2)
