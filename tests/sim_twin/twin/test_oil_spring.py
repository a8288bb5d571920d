import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from machine.calibration import nominal_calibration
from machine.conventions import CONTROL_PERIOD_S
from machine.spec import load_spec
from sim_twin.twin.oil_spring import (
    REFERENCE_RAD_M,
    SWING_RAD_PER_S,
    DriveArrays,
    OilSpringDrive,
    OilSprings,
    drive_arrays,
    squared_reach,
)
from sim_twin.twin.profile import TwinProfile, exact_profile, nominal_profile
from sim_twin.twin.response import VelocityResponse
from tests.cases import each

SPEC = load_spec()
CALIBRATION = nominal_calibration(SPEC)
NOMINAL = exact_profile(nominal_profile(SPEC))
MIDDLE = np.array([REFERENCE_RAD_M])
OIL = OilSpringDrive(
    dead_time_s=0.1,
    valve_lag_s=0.06,
    natural_frequency_rad_per_s=8.0,
    oil_damping_ratio=0.2,
    friction_damping_ratio=0.03,
    reach_inertia_ratio=0.6,
    swing_inertia_ratio=0.3,
    acceleration_limit_rad_m_per_s2=1.5,
    jerk_limit_rad_m_per_s3=6.0,
)


def linear(profile: TwinProfile) -> TwinProfile:
    """The same response, written as drives."""
    drives = [
        OilSpringDrive(
            dead_time_s=d,
            valve_lag_s=0.0,
            natural_frequency_rad_per_s=w,
            oil_damping_ratio=0.0,
            friction_damping_ratio=z,
            gain_ratio=g,
        )
        for d, w, z, g in zip(
            profile.dead_time_s,
            profile.natural_frequency_rad_per_s,
            profile.damping_ratio,
            profile.gain_ratio,
            strict=True,
        )
    ]
    return profile.model_copy(update={"drives": tuple(drives)})


@settings(max_examples=20, deadline=None)
@given(
    w=st.floats(2.0, 40.0),
    z=st.floats(0.1, 2.0),
    seed=st.integers(0, 1000),
    normal=st.floats(-2.0, 2.0),
)
def test_without_oil_it_is_the_linear_response(
    w: float, z: float, seed: int, normal: float
) -> None:
    profile = nominal_profile(SPEC).model_copy(
        update={"natural_frequency_rad_per_s": (w,) * 4, "damping_ratio": (z,) * 4}
    )
    responses = [VelocityResponse(SPEC, p, CALIBRATION, 2) for p in (profile, linear(profile))]
    for response in responses:
        response.reset(np.full((2, 3, 4), normal))
    rng = np.random.default_rng(seed)
    for _ in range(40):
        valve = rng.uniform(-1.0, 1.0, (2, 4))
        position = np.tile(MIDDLE, (2, 1)) + rng.uniform(-0.2, 0.2, (2, 4))
        one, two = (response.step(valve, position) for response in responses)
        np.testing.assert_allclose(one, two, atol=1e-10)


def solved(drive: OilSpringDrive, flows: np.ndarray, reach: float) -> np.ndarray:
    """Joint speeds at the ticks' ends by an integrator of another kind; flows are behind the valve's lag."""
    inertia = 1.0 + drive.reach_inertia_ratio * (reach - 1.0)
    w = drive.natural_frequency_rad_per_s / np.sqrt(inertia)
    oil, friction = (
        z / np.sqrt(inertia) for z in (drive.oil_damping_ratio, drive.friction_damping_ratio)
    )
    limit = (drive.acceleration_limit_rad_m_per_s2 or np.inf) / inertia
    share, n = drive.swing_inertia_ratio * reach / inertia, SWING_RAD_PER_S

    def rates(state: np.ndarray, flow: float) -> np.ndarray:
        x, y, s, rate = state
        raw = w**2 * x + 2.0 * oil * w * (flow - y)
        push = min(max(raw, -limit), limit)
        accel = push - 2.0 * friction * w * y + share * n**2 * s
        opens = abs(raw) > limit and raw * (flow - y) > 0.0
        return np.array([0.0 if opens else flow - y, accel, rate, -accel - n**2 * s])

    state, out, h = np.zeros(4), [], CONTROL_PERIOD_S / 20
    for flow in flows:
        for _ in range(20):
            first = rates(state, flow)
            middle = rates(state + 0.5 * h * first, flow)
            state = state + h * middle
        out.append(state[1])
    return np.array(out)


@each("reach", [0.6, 1.0, 1.5])
@each("limit", [None, 1.5])
def test_a_step_is_that_of_the_equations(reach: float, limit: float | None) -> None:
    drive = OIL.model_copy(
        update={
            "valve_lag_s": 0.0,
            "jerk_limit_rad_m_per_s3": None,
            "acceleration_limit_rad_m_per_s2": limit,
        }
    )
    flows = np.repeat([0.6, 0.0, -0.5], 80)
    springs = OilSprings(_one(drive), (1,))
    speeds = np.array([springs.step(np.array([v]), np.array([reach]))[0] for v in flows])
    wanted = solved(drive, flows, reach)
    assert np.abs(wanted).max() > 0.5
    assert np.abs(speeds - wanted).max() < (0.01 if limit is None else 0.03)


def _one(drive: OilSpringDrive) -> DriveArrays:
    return DriveArrays(*(part[:1] for part in drive_arrays((drive,) * 4)))


def test_an_underdamped_drive_overshoots_and_rings_and_a_far_one_more_slowly() -> None:
    free = OIL.model_copy(
        update={"acceleration_limit_rad_m_per_s2": None, "jerk_limit_rad_m_per_s3": None}
    )
    found = []
    for reach in (0.7, 1.4):
        springs = OilSprings(_one(free), (1,))
        found.append([springs.step(np.array([0.5]), np.array([reach]))[0] for _ in range(150)])
    near, far = np.array(found)
    assert near.max() > 0.55
    assert np.argmax(near) < np.argmax(far)


def test_acceleration_and_its_rise_are_limited() -> None:
    springs = OilSprings(_one(OIL), (1,))
    speeds = np.array([springs.step(np.array([1.0]), np.array([1.0]))[0] for _ in range(200)])
    accel = np.diff(speeds, prepend=0.0) / CONTROL_PERIOD_S
    assert accel.max() <= OIL.acceleration_limit_rad_m_per_s2 * 1.001
    # The damper between oil and joint acts at once.
    assert accel[:15].max() < OIL.jerk_limit_rad_m_per_s3 * 0.15 + accel[0]
    free = OilSprings(_one(OIL.model_copy(update={"jerk_limit_rad_m_per_s3": None})), (1,))
    freely = np.array([free.step(np.array([1.0]), np.array([1.0]))[0] for _ in range(200)])
    assert freely[15] > 1.5 * speeds[15]


@given(seed=st.integers(0, 10_000))
@settings(max_examples=10, deadline=None)
def test_it_stays_bounded_and_comes_to_the_speed_asked_for(seed: int) -> None:
    rng = np.random.default_rng(seed)
    drive = OilSpringDrive(
        dead_time_s=0.0,
        valve_lag_s=float(rng.uniform(0.0, 0.3)),
        natural_frequency_rad_per_s=float(rng.uniform(3.0, 40.0)),
        oil_damping_ratio=float(rng.uniform(0.1, 1.0)),
        friction_damping_ratio=0.0,
        reach_inertia_ratio=float(rng.uniform(0.0, 1.0)),
        swing_inertia_ratio=float(rng.uniform(0.0, 0.5)),
        acceleration_limit_rad_m_per_s2=float(rng.uniform(1.0, 20.0)),
        jerk_limit_rad_m_per_s3=float(rng.uniform(3.0, 200.0)),
    )
    springs = OilSprings(_one(drive), (1,))
    for _ in range(150):
        springs.step(rng.uniform(-1.0, 1.0, 1), rng.uniform(0.5, 2.0, 1))
        assert abs(springs.velocity[0]) < 6.0
    for _ in range(800):
        springs.step(np.array([0.4]), np.array([1.0]))
    # The gripper, which no friction stops here, goes on swinging.
    if drive.swing_inertia_ratio == 0.0:
        assert springs.velocity[0] == pytest.approx(0.4, abs=0.01)
    mean = np.mean([springs.step(np.array([0.4]), np.array([1.0]))[0] for _ in range(1000)])
    assert mean == pytest.approx(0.4, abs=0.05)


def test_the_reach_is_one_at_the_reference_and_grows_with_the_arm() -> None:
    assert squared_reach(SPEC, MIDDLE) == pytest.approx(np.ones((1, 4)))
    longer = squared_reach(SPEC, MIDDLE + np.array([[0.0, 0.0, 0.3, 0.5]]))
    assert (longer[0, :3] > 1.05).all()
    assert longer[0, 3] == 1.0


def test_drives_are_kept_in_a_profile_and_older_profiles_have_none(tmp_path) -> None:
    profile = nominal_profile(SPEC).model_copy(update={"drives": (OIL,) * 4})
    again = TwinProfile.model_validate_json(profile.model_dump_json())
    assert again.drives == profile.drives
    assert again.mean_lag_s == pytest.approx([0.06 + 2.0 * 0.03 / 8.0] * 4)
    old = {**nominal_profile(SPEC).model_dump(mode="json"), "schema_version": 2}
    del old["drives"]
    assert TwinProfile.model_validate(old).drives is None
