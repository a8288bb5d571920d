"""The gate's own prediction against the kinematics and ballistics that everything else uses."""

import numpy as np

from machine import ballistics
from machine.kinematics import grip_centre
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.guard import release_window
from tests.cases import each

SPEC = load_spec()


def states(count, seed=0):
    rng = np.random.default_rng(seed)
    q = rng.normal(0.0, 0.5, (count, 6))
    return q, rng.normal(0.0, 0.8, (count, 6))


def test_the_tool_moves_as_the_machine_s_kinematics_say():
    q, v = states(200)
    tube = q[:, 1] + q[:, 2]
    found = release_window.tool_motion(
        SPEC, q[:, :4], v[:, :4], tube + q[:, 4], v[:, 1] + v[:, 2] + v[:, 4], q[:, 5], v[:, 5]
    )
    known = grip_centre(SPEC, q, v)
    assert np.allclose(found.position_m, known.position_m, atol=1e-12)
    assert np.allclose(found.velocity_m_per_s, known.velocity_m_per_s, atol=1e-12)


def test_a_load_released_at_rest_falls_straight_down():
    pose = np.tile(safe_pose(0.7), (2, 1))
    landing = release_window.predicted_landing_m(SPEC, pose, np.zeros((2, 6)), np.array([0.0, 0.3]))
    tool = grip_centre(SPEC, pose, np.zeros((2, 6))).position_m
    assert np.allclose(landing, tool[:, :2], atol=1e-3)


def test_the_flight_is_that_of_a_load_without_air():
    q, v = states(100, 1)
    q[:, 1] = np.abs(q[:, 1])
    radius = SPEC.ball.radius_m
    still = SPEC.model_copy(update={"release": SPEC.release.model_copy(update={"delay_s": 0.0})})
    found = release_window.predicted_landing_m(still, q, v, np.zeros(100))
    tool = grip_centre(SPEC, q, v)
    known = ballistics.landing(tool.position_m, tool.velocity_m_per_s, radius, 0.0).position_m
    above = tool.position_m[:, 2] > radius
    assert above.sum() > 20
    assert np.allclose(found[above], known[above, :2], atol=5e-3)


def test_a_load_below_the_surface_never_lands():
    pose = safe_pose()[None]
    high = np.array([50.0])
    assert np.isnan(release_window.predicted_landing_m(SPEC, pose, np.zeros((1, 6)), high)).all()
    target = np.array([[5.0, 0.0, 50.0]])
    assert not release_window.is_allowed(SPEC, pose, np.zeros((1, 6)), target, 100.0)[0]


def test_the_region_is_a_circle_around_the_target():
    pose = safe_pose()[None]
    rest = np.zeros((1, 6))
    below = release_window.predicted_landing_m(SPEC, pose, rest, np.zeros(1))[0]
    for direction in ((1.0, 0.0), (-0.6, 0.8)):
        for miss, allowed in ((2.49, True), (2.51, False)):
            target = np.array([[*(below + miss * np.array(direction)), 0.0]])
            assert release_window.is_allowed(SPEC, pose, rest, target, 2.5)[0] == allowed


def test_limits_of_the_tool():
    pose, rest = safe_pose()[None], np.zeros((1, 6))
    assert not release_window.exceeds_tool_limits(SPEC, pose, rest)[0]
    fast = rest.copy()
    fast[0, 0] = 2.0  # 6 m out: 12 m/s
    assert release_window.exceeds_tool_limits(SPEC, pose, fast)[0]
    swinging = rest.copy()
    swinging[0, 4] = 7.0
    assert release_window.exceeds_tool_limits(SPEC, pose, swinging)[0]
    rolling = rest.copy()
    rolling[0, 5] = 7.0
    assert release_window.exceeds_tool_limits(SPEC, pose, rolling)[0]


@each("axis", [4, 5])
def test_the_gripper_swings_on_until_the_load_leaves(axis):
    """As a physical pendulum about the pitch axis: by A cos(w t) from a small angle A at rest."""
    passive, angle = SPEC.passive, 0.05
    arm = SPEC.geometry.pitch_to_roll_m + passive.gripper_com_m
    moment = passive.gripper_mass_kg * arm**2 + passive.gripper_inertia_kg_m2[0]
    w = np.sqrt(9.81 * passive.gripper_mass_kg * arm / moment)
    delay_s = SPEC.release.delay_s
    still = SPEC.model_copy(update={"release": SPEC.release.model_copy(update={"delay_s": 0.0})})
    now, then, rate = safe_pose()[None].copy(), safe_pose()[None].copy(), np.zeros((1, 6))
    now[0, axis] += angle
    then[0, axis] += angle * np.cos(w * delay_s)
    rate[0, axis] = -angle * w * np.sin(w * delay_s)
    ground = np.zeros(1)
    found = release_window.predicted_landing_m(SPEC, now, np.zeros((1, 6)), ground)
    assert np.allclose(
        found, release_window.predicted_landing_m(still, then, rate, ground), atol=3e-3
    )
