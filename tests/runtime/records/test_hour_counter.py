import os

import pytest

from machine.messages import MachineState, ThrowState
from runtime.records.hour_counter import WRITE_PERIOD_S, HourCounter


def state_at(t_s: float, state: ThrowState) -> MachineState:
    return MachineState(
        machine_id="m001",
        boot_id="b",
        t_mono_ns=round(t_s * 1e9),
        state=state,
        epoch_count=0,
        joint_position_rad_m=(0.0,) * 6,
        payload_held=True,
        stop_latched=False,
        model_sha256="m",
    )


def run(counter: HourCounter, from_s: float, to_s: float, state: ThrowState) -> dict[str, float]:
    for tenth in range(round(from_s * 10), round(to_s * 10) + 1):
        counts = counter.take(state_at(tenth / 10, state))
    return counts


def test_hours_count_what_control_lives_and_survive_a_restart(tmp_path):
    path = tmp_path / "hours.json"
    counter = HourCounter(path)
    run(counter, 100.0, 150.0, ThrowState.DISARMED)
    counts = run(counter, 150.0, 170.0, ThrowState.THROWING)
    assert counts == {"operating_s": pytest.approx(70.0), "idle_s": pytest.approx(50.0, abs=0.1)}
    # A pause, a repeated state and a clock that begins anew count as nothing.
    assert counter.take(state_at(400.0, ThrowState.DISARMED)) == counts
    assert counter.take(state_at(400.0, ThrowState.FAULT)) == counts
    assert counter.take(state_at(1.0, ThrowState.DISARMED)) == counts
    again = HourCounter(path).take(state_at(5.0, ThrowState.STOPPED))
    assert again["operating_s"] == pytest.approx(WRITE_PERIOD_S, abs=0.2)
    assert again["idle_s"] == pytest.approx(50.0, abs=0.1)


def test_a_disk_that_refuses_and_a_damaged_file_stop_nothing(tmp_path, monkeypatch):
    path = tmp_path / "hours.json"
    path.write_text('{"operating_s": "long"}', encoding="utf-8")
    counter = HourCounter(path)

    def refuse(*_: object) -> None:
        raise OSError("no space")

    monkeypatch.setattr(os, "replace", refuse)
    assert run(counter, 0.0, 65.0, ThrowState.ARMED)["operating_s"] == pytest.approx(65.0)
