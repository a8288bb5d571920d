import numpy as np
import pytest

from machine.conventions import Mode, Motion
from machine.errors import PolicyError
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.control.observation import OBSERVATION_NAMES
from runtime.control.policy_step import PolicyInputs, initial_throw, run_policies
from tests.cases import each

SPEC = load_spec()


class Scripted:
    """Answers with prepared actions and keeps what it saw."""

    def __init__(self, actions, mode=Mode.SPATIAL, is_paced=False):
        self.is_paced = is_paced
        self.is_late = False
        self.actions = np.asarray(actions, dtype=float)
        self.action_scale_rad_m_per_s = np.array([0.95, 0.5, 0.7, 0.5])[
            -(self.actions.shape[-1] - 1) :
        ]
        self.seen = []

    def infer(self, observation):
        self.seen.append(observation)
        return np.resize(self.actions, (len(observation), self.actions.shape[-1])).copy()


class Run:
    """Ticks of N machines; position of machine i is shifted by i mrad and one more mrad a tick."""

    def __init__(self, policy, mode=Mode.SPATIAL, count=2):
        self.policy, self.mode, self.count = policy, mode, count
        self.memory = initial_throw(mode, count)
        self.ticks = np.zeros(count, dtype=np.int64)
        self.before = np.zeros(count, dtype=np.int64)
        self.tick_number = 0
        self.pace_ratio = np.linspace(0.0, 1.0, count)

    def tick(self, *motions):
        motion = np.array([int(m) for m in motions])
        begins = motion != self.before
        self.ticks = np.where(begins, 0, self.ticks + 1)
        self.before = motion
        pose = np.tile(safe_pose(), (self.count, 1))
        pose[:, 1] += 1e-3 * (np.arange(self.count) * 100 + self.tick_number)
        velocity = np.full((self.count, 6), 0.01 * self.tick_number)
        target = np.tile([9.0, 1.0, 0.0], (self.count, 1))
        inputs = PolicyInputs(
            pose,
            velocity,
            target,
            motion,
            begins,
            self.ticks,
            1000 + self.tick_number,
            self.pace_ratio,
        )
        self.tick_number += 1
        self.out = run_policies(SPEC, self.mode, self.policy, self.memory, inputs)
        self.memory = self.out.memory
        return self.out


def names(mode, *wanted):
    return [OBSERVATION_NAMES[mode].index(name) for name in wanted]


def test_the_policy_runs_on_every_eighth_tick_from_the_first():
    run = Run(Scripted([0.1, 0.2, -0.3, 0.4, 0.0]))
    run.tick(Motion.HOLD, Motion.HOLD)
    assert not run.policy.seen
    asked = []
    for tick in range(30):
        before = len(run.policy.seen)
        run.tick(Motion.THROW, Motion.THROW)
        if len(run.policy.seen) > before:
            asked.append(tick)
    assert asked == [0, 8, 16, 24]


def test_machines_that_began_at_other_ticks_are_asked_at_other_ticks():
    run = Run(Scripted([0.1, 0.2, -0.3, 0.4, 0.0]))
    asked = []
    for tick in range(20):
        out = run.tick(Motion.THROW, Motion.THROW if tick >= 3 else Motion.HOLD)
        if out.row is not None:
            asked.append((tick, (out.row["t_mono_ns"] > 0).tolist(), len(run.policy.seen[-1])))
    assert asked == [
        (0, [True, False], 1),
        (3, [False, True], 1),
        (8, [True, False], 1),
        (11, [False, True], 1),
        (16, [True, False], 1),
        (19, [False, True], 1),
    ]


def test_actions_are_clipped_scaled_and_held():
    run = Run(Scripted([0.5, 2.0, -3.0, 0.1, 0.0]))
    run.tick(Motion.THROW, Motion.THROW)
    wanted = [0.475, 0.5, -0.7, 0.05]
    assert np.allclose(run.memory.request_rad_m_per_s, [wanted, wanted])
    run.policy.actions = np.zeros(5)
    for _ in range(7):
        run.tick(Motion.THROW, Motion.THROW)
        assert np.allclose(run.memory.request_rad_m_per_s, [wanted, wanted])
    run.tick(Motion.THROW, Motion.THROW)
    assert not run.memory.request_rad_m_per_s.any()


def test_in_2d_the_cabin_is_left_alone():
    run = Run(Scripted([1.0, -1.0, 0.5, 0.0]), Mode.PLANAR)
    run.tick(Motion.THROW, Motion.THROW)
    assert run.memory.request_rad_m_per_s[0].tolist() == [0.0, 0.5, -0.7, 0.25]


@each("action, released", [(0.9, False), (0.9 + 1e-9, True), (5.0, True)])
def test_the_release_latches_above_its_threshold(action, released):
    run = Run(Scripted([0.0, 0.0, 0.0, 0.0, action]))
    run.tick(Motion.THROW, Motion.HOLD)
    assert run.memory.released.tolist() == [released, False]
    run.policy.actions[-1] = -1.0
    for tick in range(20):
        run.tick(Motion.THROW, Motion.HOLD)
        assert run.memory.released.tolist() == [released, False]
        assert run.memory.released_tick_count[0] == (tick + 1 if released else 0)
    run.tick(Motion.SETTLE, Motion.HOLD)
    assert run.memory.released[0] == released
    run.tick(Motion.ALIGN, Motion.HOLD)
    assert not run.memory.released.any() and not run.memory.released_tick_count.any()


def test_a_new_throw_closes_the_gripper_of_the_last():
    run = Run(Scripted([0.0, 0.0, 0.0, 0.0, 1.0]))
    run.tick(Motion.THROW, Motion.THROW)
    run.tick(Motion.HOLD, Motion.HOLD)
    run.policy.actions[-1] = -1.0
    run.tick(Motion.THROW, Motion.HOLD)
    assert run.memory.released.tolist() == [False, True]


def test_histories_are_policy_steps_apart_and_begin_with_the_present():
    run = Run(Scripted([0.5, 0.0, 0.0, 0.0, 0.0]), count=1)
    boom = names(Mode.SPATIAL, *(f"boom_position_{age}" for age in ("k", "k-1", "k-2", "k-3")))
    rate = names(Mode.SPATIAL, "boom_velocity_k", "boom_velocity_k-1")
    previous = names(Mode.SPATIAL, "previous_slew_velocity")
    run.tick(Motion.HOLD)
    for _ in range(25):
        run.tick(Motion.THROW)
    first, second, third, fourth = run.policy.seen
    start = safe_pose()[1]
    assert np.allclose(first[0, boom], start + 0.001)
    assert np.allclose(first[0, rate], 0.01)
    assert first[0, previous] == 0.0
    assert np.allclose(second[0, boom], start + 1e-3 * np.array([9, 1, 1, 1]))
    assert np.allclose(second[0, rate], [0.09, 0.01])
    assert second[0, previous] == 0.5
    assert np.allclose(fourth[0, boom], start + 1e-3 * np.array([25, 17, 9, 1]))
    assert third.shape == (1, 65)


def test_a_second_throw_remembers_nothing_of_the_first():
    run = Run(Scripted([0.5, 0.0, 0.0, 0.0, 0.0]), count=1)
    run.tick(Motion.THROW)
    run.tick(Motion.HOLD)
    for _ in range(9):
        run.tick(Motion.THROW)
    again = run.policy.seen[1]
    boom = names(Mode.SPATIAL, "boom_position_k", "boom_position_k-3")
    assert again[0, boom[0]] == again[0, boom[1]]
    assert again[0, names(Mode.SPATIAL, "previous_slew_velocity")] == 0.0


def test_the_policy_sees_the_gripper_opened_one_step_after_it_said_so():
    run = Run(Scripted([0.0, 0.0, 0.0, 0.0, 1.0]), count=1)
    for _ in range(9):
        run.tick(Motion.THROW)
    opened = names(Mode.SPATIAL, "opened")
    assert [seen[0, opened].item() for seen in run.policy.seen] == [0.0, 1.0]


def test_the_row_holds_what_was_seen_and_said():
    run = Run(Scripted([3.0, -1.0, 0.5, 0.0]), Mode.PLANAR)
    row = run.tick(Motion.THROW, Motion.HOLD).row
    assert row["t_mono_ns"].tolist() == [1000, 0]
    assert np.allclose(row["observation_ratio"][0, :56], run.policy.seen[0][0])
    assert not row["observation_ratio"][0, 56:].any() and not row["observation_ratio"][1].any()
    assert row["action_ratio"][0].tolist() == [3.0, -1.0, 0.5, 0.0, 0.0]


def test_only_a_paced_policy_sees_the_pace_of_its_own_machine_and_the_row_leaves_it_out():
    plain, paced = (Run(Scripted([0.0] * 5, is_paced=paced)) for paced in (False, True))
    row = plain.tick(Motion.HOLD, Motion.THROW).row
    assert paced.tick(Motion.HOLD, Motion.THROW).row.tobytes() == row.tobytes()
    (without,), (seen,) = plain.policy.seen, paced.policy.seen
    assert without.shape == (1, 65) and seen.shape == (1, 66)
    assert np.array_equal(seen[:, :65], without) and seen[0, 65] == 1.0


@each("bad", [np.nan, np.inf])
@each("place", [0, 4])
def test_an_action_that_is_no_number_moves_nothing_and_opens_nothing(bad, place):
    actions = np.array([[0.5, 0.5, 0.5, 0.5, 1.0]] * 2)
    actions[1, place] = bad
    run = Run(Scripted(actions))
    out = run.tick(Motion.THROW, Motion.THROW)
    assert out.failed.tolist() == [False, True]
    assert not run.memory.request_rad_m_per_s[1].any()
    assert run.memory.released.tolist() == [True, False]
    assert np.isfinite(run.memory.action_ratio).all()
    assert not run.tick(Motion.THROW, Motion.THROW).failed.any()


def test_a_throw_without_a_policy():
    run = Run(None)
    run.tick(Motion.ALIGN, Motion.SETTLE)
    with pytest.raises(PolicyError, match="3d"):
        run.tick(Motion.THROW, Motion.HOLD)
