"""A smooth throw of the twin with scripted valves, recorded as a replay takes it; shared by tests."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from machine.calibration import nominal_calibration
from machine.conventions import CONTROL_PERIOD_NS, Array
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.driver import ValveCommand
from sim_twin.effects.effect import Effect
from sim_twin.replay.replay import ReplayInput
from sim_twin.twin.profile import exact_profile, nominal_profile
from sim_twin.twin.twin import Twin

SPEC = load_spec()
PROFILE = exact_profile(nominal_profile(SPEC))
CALIBRATION = nominal_calibration(SPEC)
TICKS = 260
OPENS_AT = 110


class Recorded(NamedTuple):
    """A throw as a replay takes it, and what else there was to see."""

    replay_input: ReplayInput
    twin: Twin
    gyro: Array
    accel: Array
    ball: Array


def scripted_valves(ticks: int = TICKS) -> Array:
    """Commands (ticks, 4) that swing the gripper outward, in both directions, at rest in the end."""
    t = 0.01 * np.arange(ticks)
    on = (t < 1.6) * np.minimum(t / 0.2, 1.0)
    valve = np.stack(
        [
            0.7 * np.sin(4.2 * t),
            0.5 * np.sin(3.4 * t),
            -0.6 * np.sin(3.4 * t + 0.4),
            0.5 * np.sin(2.5 * t + 1.0),
        ],
        axis=1,
    )
    return valve * on[:, None]


def record(
    effects: Sequence[Effect] = (), progress_ratio: float = 0.0, surface_m: float = 0.0
) -> Recorded:
    """Throw with a twin that has these effects; what its sensors say is the recording."""
    twin = Twin(
        count=1,
        profile=PROFILE,
        calibration=CALIBRATION,
        effects=[effects],
        progress_ratio=progress_ratio,
    )
    twin.set_surface_height(np.array([surface_m]))
    pose = safe_pose()
    twin.reset(pose[None], 0)
    start_ns = twin.now_ns()
    valve, opens = scripted_valves(), np.arange(TICKS) >= OPENS_AT
    rows: dict[str, list[Array]] = {n: [] for n in ("q", "v", "s", "sv", "gyro", "accel", "ball")}
    for tick in range(TICKS):
        sample = twin.read()
        rows["q"].append(sample.joint_position_rad_m[0])
        rows["v"].append(sample.joint_velocity_rad_m_per_s[0])
        rows["s"].append(twin.joint_position_rad_m[0, 4:])
        rows["sv"].append(twin.joint_velocity_rad_m_per_s[0, 4:])
        rows["ball"].append(sample.ball_position_m[0])
        twin.write(ValveCommand(valve[tick : tick + 1], opens[tick : tick + 1]))
        twin.advance(twin.now_ns() + CONTROL_PERIOD_NS)
        rows["gyro"].append(twin.read().imu_gyro_rad_per_s[0])
        rows["accel"].append(twin.read().imu_accel_m_per_s2[0])
    assert not twin.collided()[0]
    assert twin.read().impact_t_mono_ns[0] > 0, "the throw is over before the recording"
    tape = {name: np.stack(values) for name, values in rows.items()}
    replay_input = ReplayInput(
        valve_ratio=valve,
        gripper_open=opens,
        position_rad_m=tape["q"],
        velocity_rad_m_per_s=tape["v"],
        swing_start_rad=pose[4:].copy(),
        swing_rate_start_rad_per_s=np.zeros(2),
        surface_height_m=surface_m,
        progress_ratio=progress_ratio,
        opening_t_s=float(twin.payload.release_t_ns[0] - start_ns) * 1e-9,
        swing_rad=tape["s"],
        swing_rate_rad_per_s=tape["sv"],
    )
    return Recorded(replay_input, twin, tape["gyro"], tape["accel"], tape["ball"])
