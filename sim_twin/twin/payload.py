"""The load of N twin machines: held, released after the opening delay, in flight, landed and surveyed.

The flight is integrated with machine.ballistics, outside MuJoCo.
"""

import numpy as np

from machine.ballistics import Spin, drag_per_m, landing, step_flight
from machine.conventions import Array, BoolArray, IntArray
from machine.kinematics import ToolState
from machine.site.solids import Solids
from machine.site.touchdown import Touchdown, touchdown
from machine.spec import MachineSpec
from sim_twin.effects.arrays import EffectArrays
from sim_twin.effects.load_effects import LoadEffects
from sim_twin.twin.profile import TwinProfile

NEVER_NS = np.iinfo(np.int64).max


class Payload:
    """Loads of N machines; times in ns of the driver's clock, positions (N, 3) in the survey frame.

    The survey frame is frame `machine` at the surveyed pose of the base (sim_twin.twin.base_pose).
    """

    def __init__(
        self,
        spec: MachineSpec,
        profile: TwinProfile,
        count: int,
        effects: EffectArrays | None = None,
    ) -> None:
        self._profile, self._count = profile, count
        self._effects = None if effects is None else LoadEffects(spec, effects)
        drag_coefficient = profile.drag_coefficient_ratio
        wind = np.asarray(profile.wind_m_per_s, dtype=np.float64)
        nominal = drag_per_m(spec.ball)
        if self._effects is None:
            share, self.wind_m_per_s = 1.0, np.broadcast_to(wind, (count, 3))
        else:
            drag_coefficient = self._effects.drag_coefficient(drag_coefficient)
            share, self.wind_m_per_s = self._effects.mass_share, wind + self._effects.wind_m_per_s
        self._drag_nominal_per_m = (
            nominal * drag_coefficient / spec.ball.drag_coefficient_ratio * share
        )
        self._radius_m = spec.ball.radius_m
        self.spin: Spin | None = None
        """Spin from the release on; None if no load spins."""
        if self._effects is not None and self._effects.spins:
            self.spin = Spin(np.zeros((count, 3)), self._effects.air_per_m)
        self.surface_height_m = np.zeros(count)
        """Height of the surface that loads land on. Ignored if there are solids."""
        self.solids: Solids | None = None
        """Objects around the machine; None for a plane only."""
        self.predicted: Touchdown | None = None
        """First contacts of released loads, from the last prediction; None without solids."""
        self.held = np.zeros(count, dtype=np.bool_)
        self.flying = np.zeros(count, dtype=np.bool_)
        self.release_t_ns = np.full(count, NEVER_NS)
        """Time of the release; `NEVER_NS` while no opening is in progress."""
        self.release_position_m = np.full((count, 3), np.nan)
        self.release_velocity_m_per_s = np.full((count, 3), np.nan)
        self.position_m = np.full((count, 3), np.nan)
        """State of a load in flight; NaN otherwise."""
        self.impact_t_ns: IntArray = np.zeros(count, dtype=np.int64)
        self.impact_m = np.full((count, 3), np.nan)
        """True contact point on the surface."""
        self._velocity = np.full((count, 3), np.nan)
        self._delay_ns: IntArray = np.zeros(count, dtype=np.int64)
        self.drag_per_m: Array = np.zeros(count) + self._drag_nominal_per_m
        self._last_open = np.zeros(count, dtype=np.bool_)
        self._survey_error = np.zeros((count, 2))

    def reset(self, normal: Array) -> None:
        """Take up loads; `normal` (N, 4) are standard normal numbers for delay, drag, survey x and y."""
        p, mean_s, sd_s = (
            self._profile,
            self._profile.release_delay_s,
            self._profile.release_delay_sd_s,
        )
        if self._effects is not None:
            mean_s, sd_s = self._effects.delay(mean_s, sd_s)
        delay_s = mean_s + normal[:, 0] * sd_s
        self._delay_ns = np.round(np.clip(delay_s, 0.0, None) * 1e9).astype(np.int64)
        self.drag_per_m = self._drag_nominal_per_m * np.clip(
            1.0 + normal[:, 1] * p.spread.drag_sd_ratio, 0.0, None
        )
        self._survey_error = normal[:, 2:4] * p.noise.survey_sd_m
        self.load()

    def load(self) -> None:
        """Put a load into every gripper, replacing loads in flight or landed."""
        self.held[:] = True
        self.flying[:] = False
        self.release_t_ns[:] = NEVER_NS
        self.impact_t_ns[:] = 0
        for array in (
            self.impact_m,
            self.position_m,
            self.release_position_m,
            self.release_velocity_m_per_s,
        ):
            array[:] = np.nan
        self._last_open[:] = False

    def command(self, gripper_open: BoolArray, now_ns: int) -> None:
        """Open as commanded; a command withdrawn before the release keeps the load."""
        if not np.count_nonzero(gripper_open != self._last_open):
            return
        rising = gripper_open & ~self._last_open & self.held
        self.release_t_ns[rising] = now_ns + self._delay_ns[rising]
        self.release_t_ns[~gripper_open & self.held] = NEVER_NS
        self._last_open = gripper_open.copy()

    def open_at(self, command_t_ns: IntArray, gone_t_ns: IntArray | None = None) -> None:
        """Prescribe release times instead of commands.

        Args:
            command_t_ns: (N,) times of the opening commands, or `NEVER_NS`.
            gone_t_ns: (N,) known release times, `NEVER_NS` elsewhere.
        """
        commanded = command_t_ns != NEVER_NS
        self.release_t_ns[:] = NEVER_NS
        self.release_t_ns[commanded] = (command_t_ns + self._delay_ns)[commanded]
        if gone_t_ns is not None:
            known = gone_t_ns != NEVER_NS
            self.release_t_ns[known] = gone_t_ns[known]

    def due(self, until_ns: int) -> IntArray:
        """Indices of the machines whose load is released by `until_ns`."""
        return (self.held & (self.release_t_ns <= until_ns)).nonzero()[0]

    def release(
        self, rows: IntArray, before: ToolState, after: ToolState, until_ns: int, tick_s: float
    ) -> None:
        """Release the loads of `rows` within the tick that ends at `until_ns`.

        Within the tick the grip centre's velocity is interpolated linearly, its position by a cubic.
        """
        late_s = (until_ns - self.release_t_ns[rows]) * 1e-9
        share = np.clip(1.0 - late_s / tick_s, 0.0, 1.0)[:, None]
        p0, v0 = before.position_m, before.velocity_m_per_s
        p1, v1 = after.position_m, after.velocity_m_per_s
        u2, u3 = share**2, share**3
        position = (
            (2 * u3 - 3 * u2 + 1) * p0
            + (u3 - 2 * u2 + share) * tick_s * v0
            + (3 * u2 - 2 * u3) * p1
            + (u3 - u2) * tick_s * v1
        )
        velocity = v0 + share * (v1 - v0)
        if self._effects is not None:
            velocity = self._effects.slowed(rows, velocity)
        self._leave(rows, position, velocity)

    def launch(self, position_m: Array, velocity_m_per_s: Array) -> None:
        """Start the flight of all loads from given states (N, 3) at time 0."""
        self.release_t_ns[:] = 0
        known = np.isfinite(position_m).all(axis=1) & np.isfinite(velocity_m_per_s).all(axis=1)
        rows = np.flatnonzero(known)
        self._leave(rows, position_m[rows], velocity_m_per_s[rows])

    def _leave(self, rows: IntArray, position: Array, velocity: Array) -> None:
        if self._effects is not None and self.spin is not None:
            self.spin.surface_m_per_s[rows] = self._effects.spin_surface(rows, velocity)
        self.held[rows] = False
        self.flying[rows] = True
        self.release_position_m[rows], self.release_velocity_m_per_s[rows] = position, velocity
        self.position_m[rows], self._velocity[rows] = position, velocity

    def fly(self, now_ns: int, tick_s: float) -> None:
        """Advance loads in flight to `now_ns`: one tick, or the part of it after their release."""
        if not np.count_nonzero(self.flying):
            return
        rows = np.flatnonzero(self.flying)
        step_s = np.minimum((now_ns - self.release_t_ns[rows]) * 1e-9, tick_s)
        p0, v0, drag = self.position_m[rows], self._velocity[rows], self.drag_per_m[rows]
        spin = None if self.spin is None else self.spin.of(rows)
        p1, v1 = step_flight(p0, v0, drag, self.wind_m_per_s[rows], step_s, spin)
        self.position_m[rows], self._velocity[rows] = p1, v1
        if self.solids is not None:
            hits = self.solids.closes(p0, p1, self._radius_m)
            if hits.any():
                begin_ns = now_ns - np.round(step_s[hits] * 1e9).astype(np.int64)
                self._meet(rows[hits], p0[hits], v0[hits], begin_ns)
            return
        plane = self.surface_height_m[rows] + self._radius_m
        # A load that never rose above a raised surface falls to the ground beside it.
        plane = np.where(p0[:, 2] > plane, plane, np.minimum(plane, self._radius_m))
        down = (p1[:, 2] <= plane) & (v1[:, 2] < 0.0)
        if down.any():
            begin_ns = now_ns - np.round(step_s[down] * 1e9).astype(np.int64)
            self._touch_down(rows[down], p0[down], v0[down], plane[down], begin_ns)

    def _touch_down(
        self, rows: IntArray, position: Array, velocity: Array, plane: Array, begin_ns: IntArray
    ) -> None:
        """End the flight of `rows`, which cross their plane within the tick from `begin_ns`."""
        spin = None if self.spin is None else self.spin.of(rows)
        end = landing(
            position, velocity, plane, self.drag_per_m[rows], self.wind_m_per_s[rows], spin
        )
        self.impact_m[rows] = end.position_m
        # The survey measures the contact point on the surface, not the ball's centre.
        self.impact_m[rows, 2] = plane - self._radius_m
        self._end_flight(rows, begin_ns, end.time_s)

    def _meet(self, rows: IntArray, position: Array, velocity: Array, begin_ns: IntArray) -> None:
        """End the flight of `rows`, which touch a solid within the tick from `begin_ns`."""
        end = self._to_solids(rows, position, velocity)
        self.impact_m[rows] = end.contact.point_m
        self._end_flight(rows, begin_ns, end.time_s)

    def _end_flight(self, rows: IntArray, begin_ns: IntArray, time_s: Array) -> None:
        # A load whose state is not finite, as in simulations with extreme parameters, has no contact time.
        self.impact_t_ns[rows] = begin_ns + np.round(np.nan_to_num(time_s) * 1e9).astype(np.int64)
        self.flying[rows] = False
        self.position_m[rows] = np.nan

    def _to_solids(self, rows: IntArray, position: Array, velocity: Array) -> Touchdown:
        assert self.solids is not None
        spin = None if self.spin is None else self.spin.of(rows)
        drag, wind = self.drag_per_m[rows], self.wind_m_per_s[rows]
        return touchdown(self.solids, self._radius_m, position, velocity, drag, wind, spin)

    def predicted_impact(self) -> tuple[Array, Array]:
        """Predicted impact points (N, 3) and flight times (N,) of released loads; NaN while held.

        Available at the release. Without solids a raised surface is an infinite plane.
        """
        if self.solids is not None:
            rows = np.arange(self._count)
            end = self._to_solids(rows, self.release_position_m, self.release_velocity_m_per_s)
            self.predicted = end
            return end.contact.point_m, end.time_s
        plane = self.surface_height_m + self._radius_m
        end = landing(
            self.release_position_m,
            self.release_velocity_m_per_s,
            plane,
            self.drag_per_m,
            self.wind_m_per_s,
            self.spin,
        )
        point = end.position_m
        point[:, 2] -= self._radius_m
        return point, end.time_s

    def survey(self) -> tuple[IntArray, Array]:
        """Times (N,) and surveyed points (N, 3) of the impacts; 0 and NaN before the impact."""
        point = self.impact_m.copy()
        point[:, :2] += self._survey_error
        return self.impact_t_ns.copy(), point
