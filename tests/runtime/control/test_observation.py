import jax
import numpy as np

from machine.conventions import Mode
from machine.kinematics import aligned_slew_rad, grip_centre, to_throw_frame
from machine.spec import load_spec
from machine.starts import safe_pose, sample_starts
from runtime.control import observation
from runtime.control.observation import ACTION_NAMES, OBSERVATION_NAMES
from tests.cases import each

SPEC = load_spec()
RNG = np.random.default_rng(4)


def random_machines(count=50):
    angle, range_m = RNG.uniform(-np.pi, np.pi, count), RNG.uniform(5.5, 10.9, count)
    target = np.stack([range_m * np.cos(angle), range_m * np.sin(angle), 0.0 * angle], axis=1)
    pose = sample_starts(SPEC, Mode.SPATIAL, target, RNG)
    pose[:, 4:] += RNG.normal(0.0, 0.3, (count, 2))
    return pose, RNG.normal(0.0, 0.4, (count, 6)), target


def observe(mode, q, v, target, *pace):
    turns = observation.start_turns(q[..., 0], target)
    frame = observation.policy_frame(SPEC, mode, q, v, target, turns)
    positions = observation.start_history(frame.joint_position_rad_m)
    velocities = observation.push_history(
        observation.start_history(0.5 * v), frame.joint_velocity_rad_m_per_s
    )
    action = q[..., : len(ACTION_NAMES[mode])] * 3.0
    return observation.build(mode, frame, positions, velocities, action, q[..., 1] > 0.7, *pace)


@each("mode, width, actions", [(Mode.PLANAR, 56, 4), (Mode.SPATIAL, 65, 5)])
def test_names(mode, width, actions):
    assert len(OBSERVATION_NAMES[mode]) == len(set(OBSERVATION_NAMES[mode])) == width
    assert len(ACTION_NAMES[mode]) == actions
    assert ACTION_NAMES[mode][-1] == "release"


@each("mode", list(Mode))
def test_the_pace_is_one_more_entry_at_the_end(mode):
    q, v, target = random_machines()
    pace = RNG.uniform(0.0, 1.0, q.shape[0])
    plain, paced = observe(mode, q, v, target), observe(mode, q, v, target, pace)
    assert observation.observation_names(mode, True) == (*OBSERVATION_NAMES[mode], "pace")
    assert np.array_equal(paced[:, :-1], plain) and np.array_equal(paced[:, -1], pace)


@each("mode", list(Mode))
def test_every_entry_is_what_its_name_says(mode):
    q, v, target = random_machines()
    seen = observe(mode, q, v, target)
    turns = observation.start_turns(q[:, 0], target)
    frame = observation.policy_frame(SPEC, mode, q, v, target, turns)

    def entry(name):
        return seen[:, OBSERVATION_NAMES[mode].index(name)]

    joints = ["slew", "boom", "dipper", "telescope", "pitch", "roll"]
    for index, joint in enumerate(joints):
        if mode is Mode.PLANAR and joint == "slew":
            continue
        for age in ("k", "k-1", "k-2", "k-3"):
            assert np.array_equal(
                entry(f"{joint}_position_{age}"), frame.joint_position_rad_m[:, index]
            )
            factor = 1.0 if age == "k" else 0.5
            assert np.array_equal(entry(f"{joint}_velocity_{age}"), factor * v[:, index])
    for index, name in enumerate(ACTION_NAMES[mode]):
        assert np.array_equal(entry(f"previous_{name}"), np.clip(3.0 * q[:, index], -1.0, 1.0))
    for axis, letter in enumerate("xyz"):
        assert np.array_equal(entry(f"grip_position_{letter}"), frame.grip_position_m[:, axis])
        assert np.array_equal(
            entry(f"grip_velocity_{letter}"), frame.grip_velocity_m_per_s[:, axis]
        )
        assert np.array_equal(entry(f"target_{letter}"), frame.target_m[:, axis])
    delta = frame.target_m - frame.grip_position_m
    assert np.allclose(entry("horizontal_error"), np.linalg.norm(delta[:, :2], axis=1))
    assert np.allclose(entry("error"), np.linalg.norm(delta, axis=1))
    assert np.array_equal(entry("opened"), (q[:, 1] > 0.7).astype(float))


def test_3d_frame_is_the_throw_frame():
    q, v, target = random_machines()
    frame = observation.policy_frame(
        SPEC, Mode.SPATIAL, q, v, target, observation.start_turns(q[:, 0], target)
    )
    grip = grip_centre(SPEC, q, v)
    assert np.allclose(frame.grip_position_m, to_throw_frame(grip.position_m, target))
    assert np.allclose(frame.grip_velocity_m_per_s, to_throw_frame(grip.velocity_m_per_s, target))
    assert np.allclose(frame.target_m, to_throw_frame(target, target))
    slew = frame.joint_position_rad_m[:, 0]
    assert (slew >= -np.pi).all() and (slew < np.pi).all()


def test_the_slew_stays_continuous_through_a_throw():
    target = np.array([[8.0, 0.0, 0.0]])
    pose, still = np.tile(safe_pose(3.1), (1, 1)), np.zeros((1, 6))
    turns = observation.start_turns(pose[:, 0], target)
    seen = []
    for slew in np.linspace(3.1, 3.5, 9):
        pose[:, 0] = slew
        frame = observation.policy_frame(SPEC, Mode.SPATIAL, pose, still, target, turns)
        seen.append(frame.joint_position_rad_m[0, 0])
    assert np.allclose(np.diff(seen), 0.05)


@each("turns", [-3, 0, 2])
def test_whole_turns_of_the_cabin_change_nothing(turns):
    q, v, target = random_machines()
    turned = q.copy()
    turned[:, 0] += 2.0 * np.pi * turns
    for mode in Mode:
        # The previous action of `observe` is made from the joints; everything else must agree.
        action = [i for i, n in enumerate(OBSERVATION_NAMES[mode]) if n.startswith("previous_")]
        one, two = (np.delete(observe(mode, x, v, target), action, axis=1) for x in (turned, q))
        assert np.allclose(one, two)


def test_turning_machine_and_target_together_changes_nothing():
    q, v, target = random_machines()
    angle = 1.2
    c, s = np.cos(angle), np.sin(angle)
    other = target @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    turned = q.copy()
    turned[:, 0] += angle
    for mode in Mode:
        turns, turns_then = (
            observation.start_turns(x[:, 0], t) for x, t in ((q, target), (turned, other))
        )
        one = observation.policy_frame(SPEC, mode, q, v, target, turns)
        two = observation.policy_frame(SPEC, mode, turned, v, other, turns_then)
        assert np.allclose(one.grip_position_m, two.grip_position_m)
        assert np.allclose(one.grip_velocity_m_per_s, two.grip_velocity_m_per_s)
        assert np.allclose(one.target_m, two.target_m)


def test_an_aligned_2d_machine_has_its_target_ahead_in_the_arm_plane():
    _, _, target = random_machines()
    pose = sample_starts(SPEC, Mode.PLANAR, target, RNG)
    frame = observation.policy_frame(
        SPEC, Mode.PLANAR, pose, np.zeros_like(pose), target, np.zeros(len(pose))
    )
    assert np.allclose(frame.target_m[:, 1], 0.0)
    assert np.allclose(pose[:, 0], aligned_slew_rad(SPEC, target))
    assert np.allclose(frame.grip_position_m[:, 1], 0.0)


def test_history_shifts():
    history = observation.start_history(np.full((2, 6), 1.0))
    for value in (2.0, 3.0):
        history = observation.push_history(history, np.full((2, 6), value))
    assert history.shape == (2, 4, 6)
    assert history[0, :, 0].tolist() == [3.0, 2.0, 1.0, 1.0]


@each("mode", list(Mode))
def test_the_trainer_sees_the_same(mode):
    q, v, target = random_machines()
    given = [x.astype(np.float32) for x in (q, v, target)]
    compiled = jax.jit(lambda *x: observe(mode, *x))(*given)
    assert compiled.dtype == np.float32
    plain = observe(mode, *(x.astype(np.float64) for x in given))
    assert np.allclose(np.asarray(compiled), plain, atol=2e-5)
    mapped = jax.vmap(lambda *x: observe(mode, *x))(*given)
    assert np.allclose(np.asarray(mapped), plain, atol=2e-5)
