"""Making and running a challenge: data without the truth, resumable answers, refusals that say why."""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from challenge import make as challenge_make
from challenge import run as challenge
from challenge.detection_limits import limit_key, load_limits
from challenge.healthy_machines import HealthyMachine, challenge_unit, nuisance_unit
from challenge.limit_measurement import DRIFT_LIMIT_RATIO
from challenge.make import make_challenge
from challenge.run import answered, run_challenge
from challenge.sealed_truth import Tier
from diagnosis.healthy.health import Health
from diagnosis.loading.throw_data import LoadedSet
from diagnosis.verdict import Diagnosis, VerdictKind
from machine.calibration import nominal_calibration
from machine.errors import UsageError
from machine.spec import MachineSpec, load_spec
from runtime.records.log_reader import read_throw_log
from sim_twin.effects.schema import DRIFT
from sim_twin.faults.fault_tables import FAULTS
from sim_twin.twin.profile import TwinProfile, nominal_profile
from sim_twin.virtual.units import nominal_unit

POLICIES = Path(__file__).parents[2] / "policies"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A challenge of two sets of four throws, on a machine that nobody had to measure."""

    def nominal(spec: MachineSpec, unit_seed: int) -> HealthyMachine:
        return HealthyMachine(nominal_unit(spec), nominal_calibration(spec), nominal_profile(spec))

    folder = tmp_path_factory.mktemp("challenge")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(challenge_make, "healthy_machine", nominal)
        make_challenge(
            seed=3,
            out=folder / "data",
            sealed=folder / "truth.json",
            sets=2,
            throws=4,
            reference_throws=3,
            policies=POLICIES,
            tiers=[Tier.NULL, Tier.SINGLE],
            jobs=1,
        )
    return folder / "data", folder / "truth.json"


def test_a_set_is_logs_profile_and_calibration(made: tuple[Path, Path]) -> None:
    data, _ = made
    names = ["manifest.json", "reference", "set-0001", "set-0002"]
    assert sorted(p.name for p in data.iterdir()) == names
    for name in ("set-0001", "set-0002"):
        files = sorted(p.name for p in (data / name).iterdir())
        logs = [f"{name}-{i:04d}.mcap" for i in range(4)]
        assert files == sorted([*logs, "calibration.json", "profile.json"])
        modes = []
        for path in logs:
            log = read_throw_log(data / name / path)
            modes.append(log.metadata["mode"])
            assert log.metadata["twin_profile"]["machine_id"] == "nominal"
            assert log.impact is not None
            ticks = log.control["tick_count"]
            assert 0 < ticks[-1] + 1 - ticks.size < 0.05 * ticks.size
            reach = np.hypot(log.metadata["target"]["x_m"], log.metadata["target"]["y_m"])
            assert 7.0 <= reach <= 10.0
        assert modes == ["2d", "3d", "2d", "3d"]


def test_the_data_do_not_hold_the_truth(made: tuple[Path, Path]) -> None:
    data, sealed = made
    words = [*FAULTS, "null", "single", "multiple_ratio"]
    hidden = json.loads(sealed.read_text())["sets"]
    assert sum(bool(s["effects"]) for s in hidden) == 1
    for path in data.rglob("*"):
        if path.suffix == ".mcap":
            written = json.dumps(read_throw_log(path).metadata)
        elif path.is_file():
            written = path.read_text()
        else:
            continue
        written = written.replace("release_delay_s", "").replace("release_delay_sd_s", "")
        found = [word for word in words if f'"{word}"' in written]
        assert found == []


def test_the_manifest_seals_the_truth(made: tuple[Path, Path]) -> None:
    data, sealed = made
    manifest = json.loads((data / "manifest.json").read_text())
    assert manifest["sealed_sha256"] == hashlib.sha256(sealed.read_bytes()).hexdigest()
    assert "seed" not in manifest


def test_places_that_would_spoil_it_are_refused(tmp_path: Path, made: tuple[Path, Path]) -> None:
    def make(out: Path, sealed: Path) -> None:
        make_challenge(seed=1, out=out, sealed=sealed, sets=1, throws=3, policies=POLICIES, jobs=1)

    with pytest.raises(UsageError, match="inside"):
        make(tmp_path / "data", tmp_path / "data" / "truth.json")
    with pytest.raises(UsageError, match="does not exist"):
        make(tmp_path / "data", tmp_path / "nowhere" / "truth.json")
    (tmp_path / "mine.txt").write_text("")
    with pytest.raises(UsageError, match="other files"):
        make(tmp_path, tmp_path.parent / "truth.json")


def _fake(loaded: LoadedSet, profile: TwinProfile, health: Health, *, is_alone: bool) -> Diagnosis:
    assert health.is_own
    assert is_alone, "one set at a time may have a second process"
    if "set-0002" in loaded.throws[0].throw_id:
        raise ValueError("broken on purpose")
    return Diagnosis(verdict=VerdictKind.NONE, evidence={"clocks": 1, "where": None})


def test_running_is_blind_resumable_and_outlives_errors(
    tmp_path: Path, made: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    data, sealed = made
    monkeypatch.setitem(challenge.METHODS, "diagnose", _fake)
    opened: list[str] = []
    plain = Path.read_text

    def watched(self: Path, *args: Any, **kwargs: Any) -> str:
        opened.append(self.name)
        return plain(self, *args, **kwargs)

    monkeypatch.setattr(Path, "read_text", watched)
    out = tmp_path / "answers.json"
    seen: list[tuple[int, int]] = []
    assert run_challenge(data, out, limit=1, progress=lambda a, b: seen.append((a, b))) == 1
    assert seen == [(0, 1), (1, 1)]
    assert run_challenge(data, out) == 1
    assert run_challenge(data, out) == 0
    assert sealed.name not in opened
    (document,) = answered([out])
    assert document["sets"]["set-0001"]["said"]["verdict"] == "none"
    assert "clocks" not in document["sets"]["set-0001"]["said"]["evidence"]
    assert document["sets"]["set-0002"]["said"] == {"error": "ValueError: broken on purpose"}


def test_answers_to_something_else_are_refused(tmp_path: Path, made: tuple[Path, Path]) -> None:
    data, _ = made
    out = tmp_path / "answers.json"
    out.write_text(json.dumps({"schema_version": 1, "method": "lag_rmse", "sealed_sha256": "x"}))
    with pytest.raises(UsageError, match="another challenge"):
        run_challenge(data, out)
    with pytest.raises(UsageError, match="--method luck"):
        run_challenge(data, tmp_path / "new.json", method="luck")
    with pytest.raises(UsageError, match="no challenge"):
        run_challenge(tmp_path, tmp_path / "new.json")
    with pytest.raises(UsageError, match="no answers"):
        answered([tmp_path / "missing.json"])


def test_nuisance_is_small_and_spares_nothing() -> None:
    unit = challenge_unit(load_spec(), 5)
    near = nuisance_unit(unit, np.random.default_rng(1))
    assert near.pump_flow_m3_per_s != unit.pump_flow_m3_per_s
    assert near.pump_flow_m3_per_s == pytest.approx(unit.pump_flow_m3_per_s, rel=0.02)
    assert near.boom_length_m == pytest.approx(unit.boom_length_m, abs=0.010)
    assert near.joint_bias_rad_m == pytest.approx((0.0,) * 4, abs=0.0006)
    assert near.base_tilt_rad != (0.0, 0.0)
    assert unit.gripper_mass_kg == nominal_unit(load_spec()).gripper_mass_kg
    assert unit.spool_lag_s != nominal_unit(load_spec()).spool_lag_s


def _joint(drift: list[str]) -> str | None:
    return drift[1] if len(drift) == 4 else None


def test_limits_cover_every_effect_and_lie_within_its_bounds() -> None:
    limits = load_limits()
    for name, size in limits.items():
        parts = name.split(".")
        if parts[0] == DRIFT:
            assert (
                size
                >= 0.999
                * DRIFT_LIMIT_RATIO
                * limits[limit_key(parts[-2], _joint(parts), parts[-1])]
            )
            continue
        bounds = FAULTS[parts[0]].bounds[parts[-1]]
        assert 0.0 < size <= bounds[1]
    assert {name.split(".")[0] for name in limits} == {*FAULTS, DRIFT}
    with pytest.raises(UsageError, match="cannot be read"):
        load_limits(Path("/nowhere.json"))
