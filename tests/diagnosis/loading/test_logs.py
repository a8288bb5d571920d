"""Loading throw logs: what is repaired, what is refused and why."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from diagnosis.loading.logs import load_throws
from diagnosis.verdict import VerdictKind
from machine.calibration import nominal_calibration
from machine.conventions import Motion
from machine.messages import ImpactSurvey
from machine.spec import load_spec
from machine.telemetry import BALL_ROW, CONTROL_ROW, IMU_ROW
from runtime.records.log_writer import write_throw_log
from runtime.records.throw_log import RESULT_RECORD, ThrowLog
from tests.cases import each

SPEC = load_spec()
START_NS = 5_000_000_000
HISTORY_TICKS = 250
TICKS = 650
OPEN_TICK = HISTORY_TICKS + 250
TICK_NS = 10_000_000


def make_log(seed: int = 0, machine_id: str = "m001") -> ThrowLog:
    """A plausible throw: every joint swings, 2.5 s to the opening, impact 0.9 s later."""
    rng = np.random.default_rng(seed)
    rows = np.zeros(TICKS, dtype=CONTROL_ROW)
    tick = np.arange(TICKS)
    t_s = (tick - HISTORY_TICKS) * 0.01
    rows["t_mono_ns"] = START_NS + tick * TICK_NS
    rows["sensor_t_mono_ns"] = rows["t_mono_ns"] - 4_000_000
    rows["tick_count"] = tick
    rows["motion_code_count"] = np.where(
        tick < HISTORY_TICKS, Motion.ALIGN, np.where(tick < OPEN_TICK, Motion.THROW, Motion.SETTLE)
    )
    centre = np.array([0.0, 0.5, 0.0, 0.8])
    amplitude = np.array([0.3, 0.15, 0.3, 0.2])
    position = centre + amplitude * np.sin(2.0 * t_s[:, None])
    velocity = amplitude * 2.0 * np.cos(2.0 * t_s[:, None])
    rows["sensor_position_rad_m"] = position + rng.normal(0.0, 0.001, position.shape)
    rows["sensor_velocity_rad_m_per_s"] = velocity + rng.normal(0.0, 0.005, position.shape)
    rows["joint_position_rad_m"][:, :4] = rows["sensor_position_rad_m"]
    rows["joint_position_rad_m"][:, 4] = -1.0 + 0.2 * np.sin(3.0 * t_s)
    rows["valve_applied_ratio"] = velocity
    rows["gripper_open_commanded"] = tick >= OPEN_TICK
    rows["payload_held"] = tick < OPEN_TICK + 12
    rows["supply_pressure_pa"] = 3.5e7
    imu = np.zeros(TICKS, dtype=IMU_ROW)
    imu["t_mono_ns"] = rows["t_mono_ns"] - 6_000_000
    imu["gyro_rad_per_s"] = rng.normal(0.0, 0.3, (TICKS, 3))
    imu["accel_m_per_s2"] = rng.normal((0.0, 0.0, 9.81), 0.1, (TICKS, 3))
    ball = np.zeros(40, dtype=BALL_ROW)
    ball["t_mono_ns"] = rows["t_mono_ns"][OPEN_TICK + 14] + np.arange(40) * 2 * TICK_NS
    flight_s = np.arange(40) * 0.02
    ball["position_m"] = np.stack([5.0 + 4.0 * flight_s, 0.0 * flight_s, 2.0 - flight_s], axis=1)
    ball["position_m"] += rng.normal(0.0, 0.02, (40, 3))
    return ThrowLog(
        metadata={
            "throw_id": f"{machine_id}-{seed:04d}",
            "machine_id": machine_id,
            "mode": "3d",
            "target": {"x_m": 8.0, "y_m": 0.0, "z_m": 0.0},
            "model_sha256": SPEC.sha256,
            "calibration": nominal_calibration(SPEC, machine_id).model_dump(mode="json"),
            RESULT_RECORD: {"outcome": "landed"},
        },
        control=rows,
        imu=imu,
        ball=ball,
        impact=ImpactSurvey(position_m=(8.1, 0.1, 0.0), sd_m=0.02, source="survey"),
        impact_t_mono_ns=int(rows["t_mono_ns"][OPEN_TICK]) + 1_000_000_000,
    )


def with_metadata(log: ThrowLog, **values: Any) -> ThrowLog:
    return replace(log, metadata={**log.metadata, **values})


def write(folder: Path, *logs: ThrowLog) -> list[Path]:
    return [write_throw_log(folder / f"{number}.mcap", log).path for number, log in enumerate(logs)]


def reason(folder: Path, log: ThrowLog) -> str:
    """Why the one log is refused."""
    loaded = load_throws(write(folder, log))
    assert not loaded.throws
    ((_, text),) = loaded.refused
    return text


def test_a_sound_set_is_taken_whole_with_its_history_rates_and_clocks(tmp_path: Path) -> None:
    write(tmp_path, *[make_log(seed) for seed in range(3)])
    loaded = load_throws([tmp_path])
    assert loaded.refused == ()
    assert loaded.too_few() is None
    throw = loaded.throws[0]
    assert throw.t_s[0] == pytest.approx(-2.0)
    assert np.allclose(np.diff(throw.t_s), 0.01)
    assert throw.open_command_t_s == pytest.approx(2.5)
    assert throw.switch_open_t_s == pytest.approx(2.62)
    assert throw.impact_t_s == pytest.approx(3.5)
    assert throw.notes == ()
    assert loaded.rates == pytest.approx({"control": 100.0, "imu": 100.0, "ball": 50.0})
    assert loaded.clocks[throw.throw_id]["sensor_age_s"] == pytest.approx(0.004)
    rows = make_log(0).control[HISTORY_TICKS - 200 :]
    assert np.array_equal(throw.valve_ratio, rows["valve_applied_ratio"])
    assert np.allclose(throw.sensor_position_rad_m, rows["sensor_position_rad_m"], atol=1e-9)
    assert throw.joint_position_rad_m.shape == (len(throw.t_s), 6)


def test_small_holes_and_duplicates_are_repaired_and_named(tmp_path: Path) -> None:
    log = make_log()
    rows = np.delete(log.control, [300, 400, 401, 402])
    rows = np.concatenate([rows[:350], rows[349:]])
    rows["sensor_position_rad_m"][310:312, 1] = math.nan
    (throw,) = load_throws(write(tmp_path, replace(log, control=rows))).throws
    notes = " / ".join(throw.notes)
    assert "1 duplicate control rows dropped" in notes
    assert "4 missing control ticks interpolated" in notes
    assert "sensor_position_rad_m: 2 missing values interpolated" in notes
    truth = log.control[HISTORY_TICKS - 200 :]["sensor_position_rad_m"]
    assert np.max(np.abs(throw.sensor_position_rad_m - truth)) < 0.02
    # A command is held, not interpolated: the tick that is missing repeats the one before.
    missing = 400 - (HISTORY_TICKS - 200)
    assert np.array_equal(throw.valve_ratio[missing], throw.valve_ratio[missing - 1])


def test_a_throw_of_which_only_the_impact_is_known_is_used(tmp_path: Path) -> None:
    log = replace(make_log(), ball=np.zeros(0, dtype=BALL_ROW))
    (throw,) = load_throws(write(tmp_path, log)).throws
    assert throw.ball_m.shape == (0, 3)
    assert throw.impact_m == pytest.approx([8.1, 0.1, 0.0])


def scaled(name: str, factor: float, joint: int | None = None) -> ThrowLog:
    log = make_log()
    rows = log.control.copy()
    if joint is None:
        rows[name] *= factor
    else:
        rows[name][:, joint] *= factor
    return replace(log, control=rows)


@each(
    ("log", "words"),
    [
        (scaled("sensor_position_rad_m", 57.3, 1), ["boom", "degrees for rad"]),
        (scaled("sensor_position_rad_m", 57.3, 0), ["slew", "degrees"]),
        (scaled("sensor_position_rad_m", 1000.0, 3), ["telescope", "mm for m", "1.77"]),
        (scaled("sensor_velocity_rad_m_per_s", 57.3, 2), ["dipper", "degrees/s"]),
        (scaled("joint_position_rad_m", 57.3), ["swapped units"]),
        (scaled("valve_applied_ratio", 100.0), ["-1..1", "per cent"]),
        (scaled("supply_pressure_pa", 1e-5), ["bar"]),
    ],
    copied="tmp_path",
)
def test_swapped_units_are_refused_with_the_range(
    tmp_path: Path, log: ThrowLog, words: list[str]
) -> None:
    text = reason(tmp_path, log)
    assert all(word in text for word in words), text


def test_swapped_units_of_imu_ball_and_survey_are_refused(tmp_path: Path) -> None:
    log = make_log()
    imu = log.imu.copy()
    imu["gyro_rad_per_s"] *= 57.3
    assert "degrees/s for rad/s" in reason(tmp_path, replace(log, imu=imu))
    imu = log.imu.copy()
    imu["accel_m_per_s2"] /= 9.81
    assert "g for m/s^2" in reason(tmp_path, replace(log, imu=imu))
    ball = log.ball.copy()
    ball["position_m"] *= 1000.0
    assert "mm for m" in reason(tmp_path, replace(log, ball=ball))
    survey = ImpactSurvey(position_m=(8100.0, 100.0, 0.0), sd_m=20.0, source="survey")
    assert "impact" in reason(tmp_path, replace(log, impact=survey))


def test_constant_channels_are_refused(tmp_path: Path) -> None:
    log = make_log()
    for name in ("sensor_position_rad_m", "sensor_velocity_rad_m_per_s"):
        rows = log.control.copy()
        rows[name][:, 2] = rows[name][0, 2]
        text = reason(tmp_path, replace(log, control=rows))
        assert "dipper" in text
        assert "constant channel" in text
    rows = log.control.copy()
    rows["valve_applied_ratio"] = 0.0
    assert "commands were not recorded" in reason(tmp_path, replace(log, control=rows))
    imu = log.imu.copy()
    imu["gyro_rad_per_s"][:, 1] = 0.0
    assert "gyro y" in reason(tmp_path, replace(log, imu=imu))


def test_slow_logs_clock_jumps_and_long_gaps_are_refused(tmp_path: Path) -> None:
    log = make_log()
    assert "10 Hz" in reason(tmp_path, replace(log, control=log.control[::10]))
    for jump_ns, words in ((-500_000_000, "jumps back"), (700_000_000, "jumps by +0.700")):
        rows = log.control.copy()
        rows["t_mono_ns"][400:] += jump_ns
        rows["sensor_t_mono_ns"][400:] += jump_ns
        assert words in reason(tmp_path, replace(log, control=rows))
    rows = np.delete(log.control, np.arange(400, 410))
    assert "0.110 s without a row" in reason(tmp_path, replace(log, control=rows))
    rows = log.control.copy()
    rows["sensor_t_mono_ns"] -= 3_000_000_000
    assert "different clocks" in reason(tmp_path, replace(log, control=rows))
    assert "IMU" in reason(tmp_path, replace(log, imu=log.imu[::10]))
    imu = log.imu.copy()
    imu["t_mono_ns"] += 60_000_000_000
    assert "another clock" in reason(tmp_path, replace(log, imu=imu))


def test_not_a_number_is_refused_when_it_is_more_than_a_hole(tmp_path: Path) -> None:
    log = make_log()
    rows = log.control.copy()
    rows["sensor_position_rad_m"][300:320, 0] = math.nan
    text = reason(tmp_path, replace(log, control=rows))
    assert "20 of" in text
    assert "NaN" in text
    imu = log.imu.copy()
    imu["gyro_rad_per_s"][::4] = math.nan
    assert "NaN" in reason(tmp_path, replace(log, imu=imu))


def test_other_machine_types_and_throws_without_a_release_are_refused(tmp_path: Path) -> None:
    log = make_log()
    assert "wrong machine" in reason(tmp_path, with_metadata(log, model_sha256="0" * 64))
    assert "calibration" in reason(tmp_path, with_metadata(log, calibration=None))
    assert "target" in reason(tmp_path, with_metadata(log, target={"x_m": None}))
    aborted = with_metadata(log, **{RESULT_RECORD: {"outcome": "aborted", "detail": "stop"}})
    assert "aborted (stop)" in reason(tmp_path, aborted)
    short = replace(log, control=log.control[:400])
    assert "without an opening command" in reason(tmp_path, short)


def test_several_machines_are_not_mixed(tmp_path: Path) -> None:
    logs = [make_log(seed) for seed in range(3)]
    loaded = load_throws(write(tmp_path, *logs, make_log(9, "m002")))
    assert [throw.machine_id for throw in loaded.throws] == ["m001"] * 3
    assert "several machines" in loaded.refused[0][1]
    even = load_throws(write(tmp_path, make_log(0), make_log(9, "m002")))
    assert even.throws == ()
    assert len(even.refused) == 2


def test_a_truncated_file_is_used_up_to_the_damage_or_refused(tmp_path: Path) -> None:
    (path,) = write(tmp_path, make_log())
    whole = path.read_bytes()
    for keep in (0, 10, 500, len(whole) // 4, len(whole) // 2):
        path.write_bytes(whole[:keep])
        loaded = load_throws([path])
        assert len(loaded.throws) + len(loaded.refused) == 1
        if loaded.throws:
            assert any("damage" in note for note in loaded.throws[0].notes)
    path.write_bytes(whole[:500])
    assert load_throws([path]).refused


def test_too_few_throws_are_bad_data_with_the_reasons(tmp_path: Path) -> None:
    loaded = load_throws([*write(tmp_path, make_log()), tmp_path / "none.mcap"])
    verdict = loaded.too_few()
    assert verdict is not None
    assert verdict.verdict is VerdictKind.BAD_DATA
    assert "1 usable throws" in verdict.sentence
    assert "no such file" in verdict.sentence
    assert verdict.evidence["refused"][0]["reason"].startswith("no such file")
