"""Batched training environment in JAX: 12.5 Hz control, 100 Hz physics.

Reference shaping and observation are the runtime's functions. The driven joints follow a randomised
velocity response, the free joints their exact dynamics, the load a ballistic flight with drag. Valves and
pressures are not modelled here: the virtual machine models them.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from machine.ballistics import drag_per_m
from machine.conventions import (
    ACTIVE_COUNT,
    CONTROL_PERIOD_S,
    JOINT_COUNT,
    POLICY_DECIMATION,
    POLICY_PERIOD_S,
    RELEASE_THRESHOLD_RATIO,
    Mode,
)
from machine.kinematics import grip_centre
from machine.spec import MachineSpec
from runtime.control.observation import (
    ACTION_NAMES,
    build,
    observation_names,
    policy_frame,
    push_history,
    start_history,
)
from runtime.control.velocity_controller import shape_reference
from training.environment.clearance import clearance, clearance_shapes
from training.environment.dynamics import (
    ResponseState,
    drawn_machine,
    passive_acceleration,
    passive_body,
    respond,
)
from training.environment.episode import EpisodeDraw, EpisodeFailure, StepInfo, draw_episode
from training.environment.flight import flight_step, landing, shortfall
from training.environment.reward import RewardInputs, step_reward
from training.environment.settle_motion import settle_request
from training.environment.state import (
    DELAY_TICKS,
    EnvironmentState,
    StartTable,
    privileged_values,
)
from training.environment.task import TaskConfig

Field = Any


def _untyped(values: jax.Array) -> Any:
    """Functions of `machine` and `runtime` are annotated for numpy and run on JAX arrays as well."""
    return values


class ThrowEnvironment:
    """Constants and pure functions of the environment. All methods can be compiled and scanned by JAX."""

    def __init__(self, spec: MachineSpec, task: TaskConfig, unroll_count: int = 1) -> None:
        self.spec = spec
        self.unroll = unroll_count
        self.task = task
        self._shapes = clearance_shapes(spec)
        self._drag = drag_per_m(spec.ball)
        self.is_paced = task.episode.pace_ratio is not None
        self.observation_count = len(observation_names(task.mode, self.is_paced))
        self.action_count = len(ACTION_NAMES[task.mode])
        limits = spec.limits
        scale = np.maximum(limits.speed_positive_rad_m_per_s, limits.speed_negative_rad_m_per_s)
        self._first_joint = 1 if task.mode is Mode.PLANAR else 0
        self.action_scale = scale[self._first_joint :]
        low, high = spec.position_range_rad_m
        margin = task.episode.joint_limit_margin_rad_m
        self._low, self._high = jnp.asarray(low + margin), jnp.asarray(high - margin)

    def reset(self, key: Field, table: StartTable, rows: Field) -> EnvironmentState:
        """Start one episode from each of the given rows (N,) of the table, with the arm at rest."""
        keys = jax.random.split(key, 3)
        count = rows.shape[0]
        start, target = table.start_rad_m[rows], table.target_m[rows]
        draw = draw_episode(keys[0], self.spec, self.task, target, self._drag)
        swing = jax.random.normal(keys[1], (2, count, 2))
        passive = self.task.passive
        position = start.at[:, 4:].add(swing[0] * jnp.asarray(passive.start_swing_sd_rad))
        velocity: Field = jnp.zeros((count, JOINT_COUNT))
        velocity = velocity.at[:, 4:].set(
            swing[1] * jnp.asarray(passive.start_swing_rate_sd_rad_per_s)
        )
        zeros4, zeros = jnp.zeros((count, ACTIVE_COUNT)), jnp.zeros(count)
        seen_q, seen_v = self._sense(keys[2], position, velocity, draw)
        grip = grip_centre(self._built(draw), _untyped(position), _untyped(velocity))
        offset = grip.position_m - target
        horizontal = jnp.hypot(offset[:, 0], offset[:, 1])
        below = shortfall(grip.position_m, jnp.zeros_like(offset), draw.plane_m)
        return EnvironmentState(
            position=position,
            velocity=velocity,
            response=ResponseState(zeros4, zeros4),
            reference=zeros4,
            delay_line=jnp.zeros((count, DELAY_TICKS, ACTIVE_COUNT)),
            disturbance=zeros4,
            q_history=start_history(seen_q),
            v_history=start_history(seen_v),
            previous_action=jnp.zeros((count, self.action_count)),
            opened=zeros,
            leave_in_s=zeros + draw.release_delay_s,
            time_s=zeros,
            # Released at rest, the load falls straight down.
            impact_distance_m=jnp.hypot(horizontal, below),
            best_error_m=jnp.stack([horizontal, jnp.linalg.norm(offset, axis=-1)], axis=-1),
            ball=jnp.zeros((count, 6)),
            gone_s=zeros - 1.0,
            flight_s=zeros,
            landing_m=grip.position_m[:, :2],
            shortfall_m=below,
            draw=draw,
        )

    def observe(self, state: EnvironmentState) -> tuple[Field, Field]:
        """Observation of the policy (N, 65 in 3D, 56 in 2D) and additional inputs of the critic (N, P)."""
        frame = policy_frame(
            self.spec,
            self.task.mode,
            state.q_history[:, 0],
            state.v_history[:, 0],
            state.draw.target_m,
            _untyped(jnp.zeros_like(state.time_s)),
        )
        observation = build(
            self.task.mode,
            frame,
            state.q_history,
            state.v_history,
            state.previous_action,
            state.opened > 0.0,
            state.draw.pace_ratio if self.is_paced else None,
        )
        hidden = privileged_values(state)
        return observation.astype(jnp.float32), hidden

    def drives(self, state: EnvironmentState) -> Field:
        """(N,) bool: whether the policy's next action drives the joints."""
        if self.task.episode.after_release == "policy":
            return jnp.ones_like(state.gone_s, dtype=jnp.bool_)
        return state.gone_s < 0.0

    def step(
        self, key: Field, state: EnvironmentState, action: Field, hurry_ratio: Field = 1.0
    ) -> tuple[EnvironmentState, Field, StepInfo]:
        """Advance one control step (80 ms). Does not reset episodes that end.

        Args:
            key: of the step's random numbers.
            state: before the step.
            action: (N, A), clipped to [-1, 1].
            hurry_ratio: () share of the loss for time that is charged at this point of the training.

        Returns:
            State, reward (N,) and how the step ended.
        """
        keys = jax.random.split(key, 3)
        count = state.time_s.shape[0]
        clipped = jnp.clip(action, -1.0, 1.0)
        opened = self._release(keys[0], state, clipped)
        request = jnp.zeros((count, ACTIVE_COUNT))
        request = request.at[:, self._first_joint :].set(clipped[:, :-1] * self.action_scale)
        response = self.task.response
        keep = np.exp(-POLICY_PERIOD_S / np.asarray(response.disturbance_correlation_s))
        shock = jax.random.normal(keys[1], (count, ACTIVE_COUNT))
        spread = jnp.asarray(response.disturbance_sd_rad_m_per_s) * np.sqrt(1.0 - keep**2)
        state = state._replace(opened=opened, disturbance=keep * state.disturbance + spread * shock)
        after, leaving, touched = self._ticks(state, request)
        after = self._fly(state, after, leaving)
        after = after._replace(time_s=state.time_s + POLICY_PERIOD_S)
        after = self._remember(keys[2], after, clipped)
        return self._judge(state, after, clipped, touched, hurry_ratio)

    def _release(self, key: Field, state: EnvironmentState, action: Field) -> Field:
        """Latch the release command (N,). Near the target at low speed it is forced at random (paper)."""
        episode = self.task.episode
        grip = grip_centre(self.spec, state.position, state.velocity)
        slow = jnp.linalg.norm(grip.velocity_m_per_s, axis=-1) < episode.override_speed_m_per_s
        near = state.impact_distance_m < episode.override_distance_m
        lucky = jax.random.uniform(key, slow.shape) < episode.override_probability_ratio
        commanded = (action[:, -1] > RELEASE_THRESHOLD_RATIO) | (slow & near & lucky)
        return jnp.where(commanded, 1.0, state.opened)

    def _built(self, draw: EpisodeDraw) -> MachineSpec:
        """Spec with this episode's randomised lengths (N,) in place of the nominal ones."""
        return drawn_machine(
            self.spec,
            telescope_to_pin_error_m=draw.telescope_to_pin_error_m,
            pitch_to_roll_error_m=draw.pitch_to_roll_error_m,
            roll_to_grip_error_m=draw.roll_to_grip_error_m,
        )

    def _ticks(
        self, state: EnvironmentState, request: Field
    ) -> tuple[EnvironmentState, tuple[Field, Field, Field], Field]:
        """Advance eight physics ticks.

        Returns:
            State; joint positions (N, 6) and velocities (N, 6) at the release and whether the load was
            released in this step (N,); smallest clearance (N,), m.
        """
        draw, built, dt = state.draw, self._built(state.draw), CONTROL_PERIOD_S
        ticks = jnp.arange(DELAY_TICKS)[:, None]
        # Linear interpolation between the two references around the dead time.
        dead_ticks = draw.response.dead_time_s[:, None] / dt
        weights = jnp.maximum(1.0 - jnp.abs(dead_ticks - ticks), 0.0)
        body = passive_body(
            self.spec,
            draw.payload_mass_kg,
            friction_scale=draw.friction_scale_ratio,
            com_error_m=draw.com_error_m,
            inertia_scale=draw.inertia_scale_ratio,
            mass_scale=draw.mass_scale_ratio,
        )
        settles = self.task.episode.after_release == "settle"

        def tick(carry: Any, _: Field) -> tuple[Any, None]:
            q, v, lags, reference, line, leave_in, gone, leave_q, leave_v, closest = carry
            wanted = request
            if settles:
                since = gone - draw.settle_delay_s
                settle = settle_request(self.spec, since, q, v)
                wanted = jnp.where((since > 0.0)[:, None], settle, request)
            reference = shape_reference(
                self.spec, _untyped(wanted), reference, q[:, :ACTIVE_COUNT], dt
            )
            line = jnp.concatenate([reference[:, None], line[:, :-1]], axis=1)
            delayed = jnp.sum(line * weights, axis=1)
            active = v[:, :ACTIVE_COUNT]
            new_active, lags = respond(draw.response, lags, active, delayed, state.disturbance, dt)
            middle = jnp.concatenate([0.5 * (active + new_active), v[:, ACTIVE_COUNT:]], axis=-1)
            free = passive_acceleration(
                built, body, q + 0.5 * dt * middle, middle, (new_active - active) / dt
            )
            new_v = jnp.concatenate([new_active, v[:, ACTIVE_COUNT:] + dt * free], axis=-1)
            new_q = q + 0.5 * dt * (v + new_v)
            leaves = (state.opened > 0.0) & (leave_in <= dt) & (gone < 0.0)
            share = jnp.clip(leave_in / dt, 0.0, 1.0)[:, None]
            leave_q = jnp.where(leaves[:, None], q + share * (new_q - q), leave_q)
            leave_v = jnp.where(leaves[:, None], v + share * (new_v - v), leave_v)
            gone = jnp.where(gone < 0.0, jnp.where(leaves, 0.0, gone), gone + dt)
            leave_in = leave_in - dt * state.opened
            closest = jnp.minimum(closest, clearance(built, self._shapes, new_q))
            new = (new_q, new_v, lags, reference, line, leave_in, gone, leave_q, leave_v, closest)
            return new, None

        first = (
            state.position, state.velocity, state.response, state.reference, state.delay_line,
            state.leave_in_s, state.gone_s, state.position, state.velocity,
            jnp.full_like(state.time_s, jnp.inf),
        )  # fmt: skip
        last, _ = jax.lax.scan(tick, first, jnp.arange(POLICY_DECIMATION), unroll=self.unroll)
        q, v, lags, reference, line, leave_in, gone, leave_q, leave_v, closest = last
        after = state._replace(
            position=q,
            velocity=v,
            response=lags,
            reference=reference,
            delay_line=line,
            leave_in_s=leave_in,
            gone_s=gone,
        )
        return after, (leave_q, leave_v, (gone >= 0.0) & (state.gone_s < 0.0)), closest

    def _fly(
        self, before: EnvironmentState, after: EnvironmentState, leaving: tuple[Field, Field, Field]
    ) -> EnvironmentState:
        """Predict the impact of a held load, and the landing of a load released in this step."""
        leave_q, leave_v, leaves = leaving
        draw = before.draw
        q = jnp.where(leaves[:, None], leave_q, after.position)
        v = jnp.where(leaves[:, None], leave_v, after.velocity)
        grip = grip_centre(self._built(draw), _untyped(q), _untyped(v))
        position, velocity = grip.position_m + draw.grasp_m, grip.velocity_m_per_s
        # The push of the opening claws is random: it acts on the throw, not on the prediction.
        velocity = velocity + jnp.where(leaves[:, None], draw.slip_m_per_s, 0.0)
        x, y, flight = landing(position, velocity, draw.plane_m, draw.drag_per_m)
        below = shortfall(position, velocity, draw.plane_m)
        gone = before.gone_s >= 0.0
        below = jnp.where(gone, before.shortfall_m, below)
        point = jnp.where(gone[:, None], before.landing_m, jnp.stack([x, y], axis=-1))
        miss = point - draw.target_m[:, :2]
        fresh = jnp.concatenate([position, velocity], axis=-1)
        ball = before.ball
        if self.task.episode.after_release == "policy":
            x, y, z, vx, vy, vz = (ball[:, i] for i in range(6))
            old = flight_step(x, y, z, vx, vy, vz, draw.drag_per_m, POLICY_PERIOD_S)
            ball = jnp.stack(old, axis=-1)
        return after._replace(
            landing_m=point,
            impact_distance_m=jnp.hypot(jnp.hypot(miss[:, 0], miss[:, 1]), below),
            shortfall_m=below,
            ball=jnp.where(gone[:, None], ball, fresh),
            flight_s=jnp.where(gone, before.flight_s, flight),
        )

    def _remember(self, key: Field, after: EnvironmentState, action: Field) -> EnvironmentState:
        """Push the sensed joints and the action into the histories."""
        seen_q, seen_v = self._sense(key, after.position, after.velocity, after.draw)
        return after._replace(
            q_history=push_history(after.q_history, seen_q),
            v_history=push_history(after.v_history, seen_v),
            previous_action=action,
        )

    def _sense(
        self, key: Field, position: Field, velocity: Field, draw: EpisodeDraw
    ) -> tuple[Field, Field]:
        """Measured joint positions (N, 6) and velocities (N, 6) with noise, bias and latency."""
        sensor = self.task.sensor
        q_sd = jnp.asarray([*sensor.position_noise_sd_rad_m, *[sensor.swing_noise_sd_rad] * 2])
        rate_sd = sensor.swing_rate_noise_sd_rad_per_s
        v_sd = jnp.asarray([*sensor.velocity_noise_sd_rad_m_per_s, rate_sd, rate_sd])
        noise = jax.random.normal(key, (2, *position.shape))
        bias = jnp.pad(draw.swing_bias_rad, ((0, 0), (ACTIVE_COUNT, 0)))
        q = position - velocity * draw.latency_s[:, None] + bias + noise[0] * q_sd
        return q, velocity + noise[1] * v_sd

    def _ended(self, after: EnvironmentState, closest: Field) -> tuple[Field, Field, Field]:
        """Landings (N,), failure codes (N,), 0 for none, and whether the state is finite and bounded (N,)."""
        episode = self.task.episode
        q = after.position
        swing = q[:, 1] + q[:, 2] + q[:, 4]
        active = q[:, :ACTIVE_COUNT]
        gone = after.gone_s >= 0.0
        lasts = episode.settle_s if episode.after_release == "settle" else after.flight_s
        landed = gone & (after.gone_s >= lasts)
        swing_limit = jnp.where(gone, episode.settle_swing_limit_rad, episode.swing_limit_rad)
        bounded = (jnp.abs(q) < 50.0).all(-1) & (jnp.abs(after.velocity) < 20.0).all(-1)
        sane = bounded & jnp.isfinite(after.impact_distance_m)
        tests = (
            (EpisodeFailure.NUMERIC, ~sane),
            (EpisodeFailure.COLLISION, closest < episode.clearance_m),
            (EpisodeFailure.LIMIT, ~gone & ((active < self._low) | (active > self._high)).any(-1)),
            (
                EpisodeFailure.SWING,
                (jnp.abs(swing) > swing_limit) | (jnp.abs(q[:, 5]) > episode.roll_limit_rad),
            ),
            (EpisodeFailure.TIMEOUT, (after.time_s > episode.time_limit_s) & (after.opened == 0.0)),
        )
        failure = jnp.zeros(q.shape[0], jnp.int32)
        for code, is_so in reversed(tests):
            failure = jnp.where(is_so, int(code), failure)
        return landed & (failure == 0), failure, sane

    def _judge(
        self,
        before: EnvironmentState,
        after: EnvironmentState,
        action: Field,
        closest: Field,
        hurry_ratio: Field,
    ) -> tuple[EnvironmentState, Field, StepInfo]:
        """End episodes and compute rewards (N,)."""
        landed, failure, sane = self._ended(after, closest)
        target = before.draw.target_m
        ball = after.ball[:, :3] - target
        error = jnp.stack(
            [jnp.hypot(ball[:, 0], ball[:, 1]), jnp.linalg.norm(ball, axis=-1)], axis=-1
        )
        leaves = (after.gone_s >= 0.0) & (before.gone_s < 0.0)
        speed = jnp.linalg.norm(after.ball[:, 3:], axis=-1)
        reward = step_reward(
            self.task.reward,
            RewardInputs(
                action=action,
                previous_action=before.previous_action,
                opened=after.opened,
                progress_m=before.impact_distance_m - after.impact_distance_m,
                error_m=error,
                best_error_m=before.best_error_m,
                landed=landed,
                landing_error_m=after.impact_distance_m,
                failed=failure > 0,
                pace_ratio=before.draw.pace_ratio,
                holds=before.gone_s < 0.0,
                left_m_per_s=jnp.where(leaves, speed, 0.0),
                hurry_ratio=hurry_ratio,
            ),
            is_paced=self.is_paced,
        )
        reward = jnp.where(sane, reward, -self.task.reward.failure_ratio)
        after = after._replace(best_error_m=jnp.minimum(after.best_error_m, error))
        short = landed & (after.shortfall_m > 0.0)
        info = StepInfo(
            done=landed | (failure > 0),
            landed=landed & ~short,
            failure=jnp.where(short, int(EpisodeFailure.SHORT), failure),
            miss_m=after.landing_m - target[:, :2],
            duration_s=after.time_s,
            closest_m=closest,
        )
        return after, reward, info
