"""The training environment: how episodes start and end, what is drawn, and what the policy sees of it."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from machine.conventions import CONTROL_PERIOD_S, POLICY_PERIOD_S, Mode
from machine.kinematics import aligned_slew_rad, grip_centre, hanging_pitch_rad
from machine.starts import is_valid_start
from runtime.control import observation
from tests.cases import each
from tests.training.tiny_training import COUNT, SPEC, Throws, host
from training.environment.clearance import clearance, clearance_shapes
from training.environment.configurations import AIM_MARGIN_M, GROUND_SHARE_RATIO, REACH_AT_HEIGHT_M
from training.environment.episode import EpisodeFailure
from training.environment.state import DELAY_TICKS, EnvironmentState
from training.environment.task import ResponseConfig

KEY = jax.random.key(11)


def _posed(throws: Throws, **joints: float | np.ndarray) -> EnvironmentState:
    """Fresh episodes at rest with these joints; the gripper plumb unless the pitch is given."""
    names = ("slew", "boom", "dipper", "telescope", "pitch", "roll")
    q = np.tile([0.0, 0.8, 0.0, 0.5, 0.0, 0.0], (COUNT, 1))
    for name, value in joints.items():
        q[:, names.index(name)] = value
    if "pitch" not in joints:
        q[:, 4] = hanging_pitch_rad(q[:, :4])
    # At rest the load would fall straight down: no progress in a step in which nothing happens.
    grip = grip_centre(SPEC, q, np.zeros_like(q)).position_m[:, :2]
    miss = np.linalg.norm(grip - np.asarray(throws.fresh.draw.target_m)[:, :2], axis=-1)
    return throws.fresh._replace(
        position=jnp.asarray(q, jnp.float32),
        velocity=jnp.zeros((COUNT, 6)),
        impact_distance_m=jnp.asarray(miss, jnp.float32),
    )


def _failures(throws: Throws, state: EnvironmentState) -> set[EpisodeFailure]:
    """What one still step ends with."""
    _, reward, info = throws.step(KEY, state, throws.still())
    info = host(info)
    np.testing.assert_array_equal(info.done, info.failure > 0)
    assert not info.landed.any()
    assert np.isfinite(reward).all()
    loss = throws.env.task.reward.failure_ratio
    assert (np.asarray(reward)[info.done] < -loss + 2.0).all()
    assert (np.asarray(reward)[~info.done] > -2.0).all()
    return {EpisodeFailure(int(code)) for code in info.failure}


# --- starts, targets, what is drawn ---------------------------------------------------------------


def test_targets_lie_within_the_range_and_starts_are_valid(throws: Throws):
    near, far = throws.env.task.episode.target_range_m
    far += AIM_MARGIN_M
    target, start = np.asarray(throws.table.target_m), np.asarray(throws.table.start_rad_m)
    assert (target[:, 0] >= near).all()
    assert (target[:, 0] <= far + 1e-5).all()
    assert target[:, 0].min() < near + 0.1
    assert target[:, 0].max() > far - 0.1
    np.testing.assert_array_equal(target[:, 1], 0.0)
    low, high = throws.env.task.episode.target_height_m
    height = target[:, 2]
    assert low <= height.min() < low + 0.1 and high - 0.1 < height.max() <= high
    assert np.mean(height == 0.0) == pytest.approx(GROUND_SHARE_RATIO, abs=0.01)
    reach = np.interp(height, *np.transpose(REACH_AT_HEIGHT_M)) + AIM_MARGIN_M
    assert (target[:, 0] <= reach + 1e-5).all() and reach.min() < 9.0
    assert is_valid_start(SPEC, start.astype(np.float64)).all()


def test_targets_go_to_45_percent_past_the_reach(throws: Throws):
    # Reach: the largest distance of the plumb grip centre from the slew axis (7.5 m).
    q = np.zeros((20000, 6))
    rng = np.random.default_rng(0)
    low, high = SPEC.position_range_rad_m
    q[:, 1:4] = rng.uniform(low[1:], high[1:], (20000, 3))
    q[:, 4] = hanging_pitch_rad(q[:, :4])
    grip = grip_centre(SPEC, q, np.zeros_like(q)).position_m
    reach = np.hypot(grip[:, 0], grip[:, 1]).max()
    assert throws.env.task.episode.target_range_m[1] == pytest.approx(1.45 * reach, rel=0.02)


def test_the_cabin_is_aligned_in_2d_and_stands_anywhere_in_3d(planar: Throws, spatial: Throws):
    target = np.asarray(planar.table.target_m, np.float64)
    np.testing.assert_allclose(
        planar.table.start_rad_m[:, 0], aligned_slew_rad(SPEC, target), atol=1e-6
    )
    slew = np.asarray(spatial.table.start_rad_m)[:, 0]
    counts, _ = np.histogram(slew, bins=8, range=(-np.pi, np.pi))
    assert counts.sum() == slew.size
    assert counts.min() > slew.size / 16


def test_the_gripper_starts_almost_plumb_and_almost_at_rest(throws: Throws):
    passive = throws.env.task.passive
    start = host(throws.fresh)
    swing = start.position[:, 1] + start.position[:, 2] + start.position[:, 4]
    for value, sd in (
        (swing, passive.start_swing_sd_rad[0]),
        (start.position[:, 5], passive.start_swing_sd_rad[1]),
        (start.velocity[:, 4], passive.start_swing_rate_sd_rad_per_s[0]),
        (start.velocity[:, 5], passive.start_swing_rate_sd_rad_per_s[1]),
    ):
        assert value.std() == pytest.approx(sd, rel=0.2)
        assert np.abs(value).max() < 5.0 * sd
    np.testing.assert_array_equal(start.velocity[:, :4], 0.0)


def test_the_response_is_drawn_between_its_bounds_and_fits_the_delay_line(throws: Throws):
    config, drawn = throws.env.task.response, host(throws.fresh.draw.response)
    assert isinstance(config, ResponseConfig)
    for name, low, high in (
        ("dead_time_s", config.dead_time_min_s, config.dead_time_max_s),
        ("lag_s", config.lag_min_s, config.lag_max_s),
        (
            "natural_frequency_rad_per_s",
            config.natural_frequency_min_rad_per_s,
            config.natural_frequency_max_rad_per_s,
        ),
        ("damping_ratio", config.damping_min_ratio, config.damping_max_ratio),
        ("gain_positive_ratio", config.gain_positive_min_ratio, config.gain_positive_max_ratio),
        ("gain_negative_ratio", config.gain_negative_min_ratio, config.gain_negative_max_ratio),
    ):
        value, lower, upper = getattr(drawn, name), np.asarray(low), np.asarray(high)
        assert (value >= lower - 1e-6).all(), name
        assert (value <= upper + 1e-6).all(), name
        # COUNT draws fill the range; the joints do not share one draw.
        assert (np.ptp(value, axis=0) >= 0.9 * (upper - lower) - 1e-6).all(), name
    for value, (lower, upper) in (
        (drawn.boom_from_dipper_ratio, config.boom_from_dipper_ratio),
        (drawn.dipper_from_boom_ratio, config.dipper_from_boom_ratio),
    ):
        assert lower <= value.min() and value.max() <= upper
        assert np.ptp(value) >= 0.9 * (upper - lower)
    assert config.boom_from_dipper_ratio[1] * config.dipper_from_boom_ratio[1] < 0.7
    assert max(config.dead_time_max_s) <= (DELAY_TICKS - 1) * CONTROL_PERIOD_S
    assert abs(np.corrcoef(drawn.dead_time_s[:, 1], drawn.dead_time_s[:, 2])[0, 1]) < 0.3


def test_machines_differ_within_the_stated_bounds(throws: Throws):
    passive, draw = throws.env.task.passive, host(throws.fresh.draw)
    for value, (low, high) in (
        (draw.friction_scale_ratio, passive.friction_scale_ratio),
        (draw.com_error_m, passive.gripper_com_error_m),
        (draw.inertia_scale_ratio, passive.gripper_inertia_scale_ratio),
        (draw.mass_scale_ratio, passive.gripper_mass_scale_ratio),
        (draw.telescope_to_pin_error_m, passive.telescope_to_pin_error_m),
        (draw.pitch_to_roll_error_m, passive.pitch_to_roll_error_m),
        (draw.roll_to_grip_error_m, passive.roll_to_grip_error_m),
        (draw.payload_mass_kg, passive.payload_mass_kg),
        (draw.release_mean_s, passive.release_delay_mean_s),
        (draw.latency_s, throws.env.task.sensor.latency_s),
        (draw.settle_delay_s, throws.env.task.episode.settle_delay_s),
    ):
        assert value.min() >= low - 1e-6
        assert value.max() <= high + 1e-6
        assert np.ptp(value) > 0.9 * (high - low)
    # Paper: the gripper opens 258 +- 15 ms after the command.
    assert draw.release_delay_s.mean() == pytest.approx(0.258, abs=0.004)
    assert draw.release_delay_s.std() == pytest.approx(0.015, rel=0.2)
    assert np.linalg.norm(draw.grasp_m, axis=-1).max() <= passive.grasp_error_m + 1e-6


@pytest.mark.long
def test_velocity_commands_are_disturbed_as_much_as_stated(throws: Throws):
    state, response = throws.fresh, throws.env.task.response
    seen: list[np.ndarray] = []
    for key in jax.random.split(KEY, 24):
        state = throws.step(
            key, throws.fresh._replace(disturbance=state.disturbance), throws.still()
        )[0]
        seen.append(np.asarray(state.disturbance))
    late = np.stack(seen[12:])
    np.testing.assert_allclose(late.std((0, 1)), response.disturbance_sd_rad_m_per_s, rtol=0.06)
    for joint, time in enumerate(response.disturbance_correlation_s):
        link = np.corrcoef(late[:-1, :, joint].ravel(), late[1:, :, joint].ravel())[0, 1]
        assert link == pytest.approx(np.exp(-POLICY_PERIOD_S / time), abs=0.06)


# --- the release ----------------------------------------------------------------------------------


def test_the_gripper_opens_above_nine_tenths_and_stays_open(planar: Throws):
    command = np.resize([0.0, 0.899, 0.9, 0.901, 1.0, 7.0], COUNT)
    action = planar.still().at[:, -1].set(command)
    after, _, _ = planar.step(KEY, planar.fresh, action)
    np.testing.assert_array_equal(np.asarray(after.opened), np.where(command > 0.9, 1.0, 0.0))
    again, _, _ = planar.step(KEY, after, planar.still())
    np.testing.assert_array_equal(np.asarray(again.opened), np.asarray(after.opened))


def test_the_load_leaves_after_the_drawn_delay_and_falls_below_the_grip(planar: Throws):
    state = _posed(planar)
    grip = grip_centre(SPEC, *(np.asarray(v, np.float64) for v in (state.position, state.velocity)))
    state, _, _ = planar.step(KEY, state, planar.still(1.0))
    for key in jax.random.split(KEY, 5):
        state, _, info = planar.step(key, state, planar.still())
    gone = float(state.time_s[0]) - np.asarray(planar.fresh.draw.release_delay_s)
    # Counted in control ticks from the end of the one in which it left.
    assert np.abs(np.asarray(state.gone_s) - gone).max() < 1.01 * CONTROL_PERIOD_S
    draw = host(planar.fresh.draw)
    where = grip.position_m[:, :2] + draw.grasp_m[:, :2]
    # It leaves with what a still arm and the opening claws give it: centimetres in a fall of 0.6 s.
    assert np.abs(np.asarray(state.landing_m) - where).max() < 0.12
    np.testing.assert_allclose(info.miss_m, np.asarray(state.landing_m) - draw.target_m[:, :2])


def _forced(throws: Throws, state: EnvironmentState, count: int = 16) -> np.ndarray:
    """Share of releases that nobody commanded, one of (COUNT,) over `count` tries."""
    tries = [
        np.asarray(throws.step(key, state, throws.still())[0].opened)
        for key in jax.random.split(KEY, count)
    ]
    return np.mean(tries, axis=0)


@pytest.mark.long
def test_the_papers_configuration_forces_one_release_in_twenty_near_the_target(paper: Throws):
    episode = paper.env.task.episode
    assert episode.override_probability_ratio == 0.05
    at = np.resize([0.99, 1.01], COUNT) * episode.override_distance_m
    state = _posed(paper)._replace(impact_distance_m=jnp.asarray(at, jnp.float32))
    share = _forced(paper, state)
    # 2048 tries: a standard deviation of 0.5 %
    assert share[::2].mean() == pytest.approx(0.05, abs=0.015)
    assert share[1::2].max() == 0.0


def test_no_release_is_forced_at_speed_or_in_our_configuration(paper: Throws, planar: Throws):
    near = jnp.zeros(COUNT)
    fast = _posed(paper)._replace(
        impact_distance_m=near, velocity=jnp.zeros((COUNT, 6)).at[:, 4].set(2.0)
    )
    grip = grip_centre(SPEC, *(np.asarray(v, np.float64) for v in (fast.position, fast.velocity)))
    limit = paper.env.task.episode.override_speed_m_per_s
    assert np.linalg.norm(grip.velocity_m_per_s, axis=-1).min() > limit
    assert _forced(paper, fast, 4).max() == 0.0
    assert _forced(planar, _posed(planar)._replace(impact_distance_m=near), 4).max() == 0.0


# --- how episodes end -----------------------------------------------------------------------------


def test_a_quiet_step_ends_nothing(throws: Throws):
    assert _failures(throws, _posed(throws)) == {EpisodeFailure.NONE}


def test_a_large_swing_or_roll_ends_it(throws: Throws):
    state, limit = _posed(throws), throws.env.task.episode
    swung = [
        state._replace(position=state.position.at[:, 4].add(sign * angle))
        for sign, angle in ((1.0, 1.40), (1.0, 1.25))
    ]
    assert limit.swing_limit_rad == 1.30
    assert _failures(throws, swung[0]) == {EpisodeFailure.SWING}
    assert _failures(throws, swung[1]) == {EpisodeFailure.NONE}
    for roll, end in (
        (1.2, EpisodeFailure.SWING),
        (-1.2, EpisodeFailure.SWING),
        (1.0, EpisodeFailure.NONE),
    ):
        assert _failures(throws, _posed(throws, roll=roll)) == {end}


@each(
    ("joint", "index", "others"), [("boom", 1, {}), ("telescope", 3, {"boom": 1.1, "dipper": 0.5})]
)
def test_a_joint_near_its_limit_ends_it(
    planar: Throws, joint: str, index: int, others: dict[str, float]
):
    high = SPEC.position_range_rad_m[1][index]
    margin = planar.env.task.episode.joint_limit_margin_rad_m
    ends = [
        _failures(planar, _posed(planar, **{**others, joint: high - gap}))
        for gap in (0.5 * margin, 3.0 * margin)
    ]
    assert ends == [{EpisodeFailure.LIMIT}, {EpisodeFailure.NONE}]


def test_the_ground_and_the_machine_end_it(planar: Throws):
    shapes, limit = clearance_shapes(SPEC), planar.env.task.episode.clearance_m
    # From well above the ground to below it, by the boom alone.
    state = _posed(planar, boom=np.linspace(0.8, 0.3, COUNT))
    gap = clearance(SPEC, shapes, np.asarray(state.position, np.float64))
    assert gap.max() > limit + 0.2
    assert gap.min() < 0.0
    _, _, info = planar.step(KEY, state, planar.still())
    failure = np.asarray(info.failure)
    # The lengths of the drawn machines, and what it moves in a step, blur it by less than 0.15 m.
    assert (failure[gap < limit - 0.15] == EpisodeFailure.COLLISION).all()
    assert (failure[gap > limit + 0.15] == EpisodeFailure.NONE).all()
    folded = _posed(planar, boom=0.9, dipper=-0.9, telescope=0.0)
    folded = folded._replace(position=folded.position.at[:, 4].add(-1.0))
    apart = clearance(SPEC, shapes, np.asarray(folded.position, np.float64))
    assert apart.max() < limit - 0.03, apart.max()
    assert _failures(planar, folded) == {EpisodeFailure.COLLISION}


def test_no_release_in_time_ends_it(throws: Throws):
    limit = throws.env.task.episode.time_limit_s
    late = _posed(throws)._replace(time_s=jnp.full(COUNT, limit, jnp.float32))
    early = late._replace(time_s=late.time_s - 0.1)
    assert _failures(throws, late) == {EpisodeFailure.TIMEOUT}
    assert _failures(throws, early) == {EpisodeFailure.NONE}
    opened = late._replace(opened=jnp.ones(COUNT))
    assert _failures(throws, opened) == {EpisodeFailure.NONE}


@each("field", ["position", "velocity"])
def test_a_state_that_is_not_finite_ends_it_with_a_loss(planar: Throws, field: str):
    state = _posed(planar)
    for bad in (np.nan, np.inf, 1e6):
        broken = state._replace(**{field: getattr(state, field).at[:, 4].set(bad)})
        assert _failures(planar, broken) == {EpisodeFailure.NUMERIC}


def _after_release(throws: Throws, steps: int) -> tuple[EnvironmentState, list[Any], list[Any]]:
    """Release at rest and wait; the state before the first landing, rewards and infos."""
    state, rewards, infos = _posed(throws), [], []
    for index, key in enumerate(jax.random.split(KEY, steps)):
        state, reward, info = throws.step(key, state, throws.still(1.0 if index == 0 else -1.0))
        rewards.append(np.asarray(reward))
        infos.append(host(info))
    return state, rewards, infos


def test_the_papers_episode_ends_when_the_ball_lands(paper: Throws):
    _, rewards, infos = _after_release(paper, 16)
    first = np.argmax([info.landed for info in infos], axis=0)
    # 0.26 s to open, then the fall from the grip's height.
    grip = grip_centre(SPEC, *(np.asarray(v, np.float64)[:1] for v in (_posed(paper)[:2])))
    fall = np.sqrt(2.0 * (grip.position_m[0, 2] - SPEC.ball.radius_m) / 9.81)
    expected = (0.258 + fall) / POLICY_PERIOD_S
    assert np.abs(first + 1 - expected).max() < 2.0
    # Paid for a landing 2 m and more from the target: next to nothing, but no loss.
    paid = np.take_along_axis(np.stack(rewards), first[None], axis=0)[0]
    assert (np.abs(paid) < 0.5).all()


def test_ours_ends_after_the_settle_motion_and_the_policy_no_longer_drives(planar: Throws):
    state, _, infos = _after_release(planar, 24)
    landed = np.stack([info.landed for info in infos])
    assert not np.stack([info.failure for info in infos])[: landed.argmax(0).max()].any()
    settle = planar.env.task.episode.settle_s
    wait = (landed.argmax(0) + 1) * POLICY_PERIOD_S - np.asarray(planar.fresh.draw.release_delay_s)
    assert (wait >= settle - 1e-3).all()
    assert (wait < settle + POLICY_PERIOD_S + CONTROL_PERIOD_S).all()
    assert not np.asarray(planar.env.drives(state)).any()
    assert np.asarray(planar.env.drives(planar.fresh)).all()


# --- what the policy sees -------------------------------------------------------------------------


@each("bearing", [0.0, 2.4])
def test_the_observation_is_the_runtimes(throws: Throws, bearing: float):
    """The runtime's machine stands turned by whole turns and a bearing; the policy must not notice."""
    mode, state = throws.env.task.mode, throws.fresh
    rng = np.random.default_rng(7)
    turned = np.array([bearing + 4.0 * np.pi, 0.0, 0.0, 0.0, 0.0, 0.0])
    c, s = np.cos(bearing), np.sin(bearing)
    target = np.asarray(state.draw.target_m, np.float64) @ np.array(
        [[c, s, 0], [-s, c, 0], [0, 0, 1]]
    )
    # From the true start: a start within the noise of half a turn may be seen on its other side.
    turns = observation.start_turns(
        np.asarray(state.position, np.float64)[:, 0] + turned[0], target
    )
    pace = np.asarray(state.draw.pace_ratio, np.float64)
    assert pace.min() < 0.05 and pace.max() > 0.95
    positions = velocities = np.zeros((COUNT, 4, 6))
    previous, opened = np.zeros((COUNT, throws.env.action_count)), np.zeros(COUNT, bool)
    for index, key in enumerate(jax.random.split(KEY, 6)):
        q = np.asarray(state.q_history[:, 0], np.float64) + turned
        v = np.asarray(state.v_history[:, 0], np.float64)
        frame = observation.policy_frame(SPEC, mode, q, v, target, turns)
        push = observation.push_history if index else lambda _, x: observation.start_history(x)
        positions = push(positions, frame.joint_position_rad_m)
        velocities = push(velocities, frame.joint_velocity_rad_m_per_s)
        theirs = observation.build(mode, frame, positions, velocities, previous, opened, pace)
        ours = np.asarray(throws.observe(state)[0])
        assert ours.shape == (COUNT, 66 if mode is Mode.SPATIAL else 57)
        np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=4e-6)
        previous = rng.uniform(-1.5, 1.5, previous.shape)
        previous[:, -1] = np.where(rng.random(COUNT) < 0.1, 1.0, -1.0)
        opened = opened | (previous[:, -1] > 0.9)
        state, _, _ = throws.step(key, state, jnp.asarray(previous, jnp.float32))


def test_what_the_policy_sees_is_late_biased_and_noisy_as_stated(planar: Throws):
    sensor = planar.env.task.sensor
    quiet = _posed(planar)
    state, _, _ = planar.step(KEY, quiet, planar.still())
    error = np.asarray(state.q_history[:, 0] - state.position)
    late = np.asarray(state.velocity) * np.asarray(state.draw.latency_s)[:, None]
    noise = error + late
    noise[:, 4:] -= np.asarray(state.draw.swing_bias_rad)
    wanted = [*sensor.position_noise_sd_rad_m, sensor.swing_noise_sd_rad, sensor.swing_noise_sd_rad]
    np.testing.assert_allclose(noise.std(0), wanted, rtol=0.2)
    assert np.asarray(state.draw.swing_bias_rad).std() == pytest.approx(
        sensor.swing_bias_sd_rad, rel=0.15
    )
    rate = np.asarray(state.v_history[:, 0] - state.velocity).std(0)
    sd = sensor.swing_rate_noise_sd_rad_per_s
    np.testing.assert_allclose(rate, [*sensor.velocity_noise_sd_rad_m_per_s, sd, sd], rtol=0.2)


def test_random_actions_never_give_a_number_that_is_not_finite(throws: Throws):
    state, ended = throws.fresh, np.zeros(COUNT, bool)
    seen: set[int] = set()
    for key in jax.random.split(KEY, 60):
        # Beyond the limits of the action, as exploration draws them; a release now and then.
        action = 1.5 * jax.random.normal(key, (COUNT, throws.env.action_count))
        action = action.at[:, -1].add(-3.0)
        state, reward, info = throws.step(key, state, action)
        new = np.asarray(info.done) & ~ended
        seen |= {int(code) for code in np.asarray(info.failure)[new]}
        ended |= new
        observed, hidden = throws.observe(state)
        for value in (reward, observed, hidden):
            assert np.isfinite(value).all()
    assert int(EpisodeFailure.NUMERIC) not in seen
    assert ended.mean() > 0.3
