"""Load of the virtual machine: held, released after the gripper's delay, in flight with drag, landed.

Times are those of the driver's clock. The claws are not modelled: the released load has the velocity of the
grip at its offset, plus a random velocity from the opening claws.
"""

from typing import NamedTuple, Protocol

import numpy as np

from machine.ballistics import drag_per_m, step_flight
from machine.conventions import GRAVITY_M_PER_S2, Array, BoolArray, IntArray
from machine.site.solids import Solids, touch_share
from machine.spec import Ball, MachineSpec
from sim_twin.virtual.grain_flight import GrainFlight
from sim_twin.virtual.sensors import NEVER_NS
from sim_twin.virtual.truth import GripMotion
from sim_twin.virtual.units import MachineUnit, ThrowConditions


class LoadFaults(Protocol):
    """Faults of release and flight (sim_twin.faults.load_faults)."""

    def let_go(self, which: IntArray, velocity_m_per_s: Array, rotation: Array) -> Array:
        """Velocities (M, 3) of the released loads of machines (M,), for gripper rotations (M, 3, 3)."""
        ...

    def fly(
        self, which: IntArray, position: Array, velocity: Array, wind: Array, step_s: Array
    ) -> tuple[Array, Array]:
        """Positions and velocities (M, 3) a flight step (M,) later."""
        ...


class Landed(NamedTuple):
    """Impacts in a flight step: machines (M,), times (M,), contact points (M, 3)."""

    which: IntArray
    time_ns: IntArray
    point_m: Array
    volume_m3: Array | None = None
    """(M,) of bulk material, as measured; None: balls."""
    covariance_m2: Array | None = None
    """(M, 3) xx, xy, yy of its places."""


class ThrownLoad:
    """Loads of N machines."""

    def __init__(
        self, spec: MachineSpec, unit: MachineUnit, count: int, faults: LoadFaults | None = None
    ) -> None:
        self._faults = faults
        ball = Ball(
            mass_kg=unit.ball_mass_kg,
            radius_m=unit.ball_radius_m,
            drag_coefficient_ratio=unit.drag_coefficient_ratio,
            air_density_kg_per_m3=spec.ball.air_density_kg_per_m3,
        )
        self.radius_m = unit.ball_radius_m
        self.solids: Solids | None = None
        """Objects around the machine; None for the target's plane only."""
        self.grains: GrainFlight | None = None
        """Bulk material that is thrown instead of balls."""
        self._drag_per_m = drag_per_m(ball)
        self.held = np.ones(count, dtype=np.bool_)
        self.flying = np.zeros(count, dtype=np.bool_)
        self.position_m = np.full((count, 3), np.nan)
        """Ball centres; for held loads valid after ``locate`` only."""
        self.velocity_m_per_s = np.full((count, 3), np.nan)
        self.impact_m = np.full((count, 3), np.nan)
        self.impact_ns = np.zeros(count, dtype=np.int64)
        self.release_position_m = np.full((count, 3), np.nan)
        self.release_velocity_m_per_s = np.full((count, 3), np.nan)
        self.release_ns = np.full(count, NEVER_NS, dtype=np.int64)
        self._switch_ns = np.full(count, NEVER_NS, dtype=np.int64)
        self._time_ns = np.zeros(count, dtype=np.int64)
        self._delay_ns = np.zeros(count, dtype=np.int64)
        self._switch_delay_ns = np.zeros(count, dtype=np.int64)
        self._offset_m = np.zeros((count, 3))
        self._slip_m_per_s = np.zeros((count, 3))
        self._open = np.zeros(count, dtype=np.bool_)
        self._next_release_ns = int(NEVER_NS)

    def take(self, which: BoolArray, conditions: ThrowConditions) -> None:
        """Put loads into the grippers of machines (N,), with the grasp of the conditions."""
        self.held[which], self.flying[which] = True, False
        self.release_ns[which] = self._switch_ns[which] = NEVER_NS
        self.impact_ns[which] = 0
        for values in (self.impact_m, self.release_position_m, self.release_velocity_m_per_s):
            values[which] = np.nan
        self._offset_m[which] = conditions.grasp_offset_m[which]
        self._slip_m_per_s[which] = conditions.slip_m_per_s[which]
        delays_ns = (conditions.release_delay_s * 1e9).astype(np.int64)
        self._delay_ns[which] = delays_ns[which]
        switch_ns = (conditions.switch_delay_s * 1e9).astype(np.int64)
        self._switch_delay_ns[which] = switch_ns[which]
        self._next_release_ns = int(self.release_ns.min())
        if self.grains is not None:
            self.grains.take(which)

    def close_grippers(self) -> None:
        """Close the grippers without a command edge, as in a reset."""
        self._open[:] = False

    def command(self, opens: BoolArray, now_ns: int) -> None:
        """Apply gripper commands (N,): a rising edge starts the opening, a falling one stops it."""
        if np.array_equal(opens, self._open):
            return
        waiting = self.held & (self.release_ns != NEVER_NS)
        rising = opens & ~self._open & self.held
        self.release_ns[rising] = now_ns + self._delay_ns[rising]
        self.release_ns[waiting & ~opens] = NEVER_NS
        self._open = opens.copy()
        pending = np.where(self.held, self.release_ns, NEVER_NS)
        self._next_release_ns = int(pending.min())

    def is_due(self, now_ns: int) -> bool:
        """Whether any load is released up to this time."""
        return self._next_release_ns <= now_ns

    def release_due(self, now_ns: int, grip: GripMotion) -> None:
        """Release due loads, with the grip's motion extrapolated (by at most 2 ms) to their release times."""
        due = self.held & (self.release_ns <= now_ns)
        later_s = (self.release_ns[due] - grip.time_ns)[:, None] * 1e-9
        arm_m = np.einsum("nij,nj->ni", grip.rotation[due], self._offset_m[due])
        turning: Array = np.cross(grip.rate_rad_per_s[due], arm_m).astype(np.float64)
        velocity = grip.velocity_m_per_s[due] + turning
        position = grip.position_m[due] + arm_m + velocity * later_s
        if self._faults is not None:
            velocity = self._faults.let_go(np.flatnonzero(due), velocity, grip.rotation[due])
        velocity = velocity + self._slip_m_per_s[due]
        self.position_m[due] = self.release_position_m[due] = position
        self.velocity_m_per_s[due] = self.release_velocity_m_per_s[due] = velocity
        self._time_ns[due] = self.release_ns[due]
        self._switch_ns[due] = self.release_ns[due] + self._switch_delay_ns[due]
        self.held[due], self.flying[due] = False, True
        pending = np.where(self.held, self.release_ns, NEVER_NS)
        self._next_release_ns = int(pending.min())

    def fly(self, now_ns: int, plane_m: Array, wind_m_per_s: Array) -> Landed:
        """Advance loads in flight to this time, up to solids or target surfaces at heights (N,)."""
        if self.grains is not None:
            return self._fly_grains(self.grains, now_ns, plane_m, wind_m_per_s)
        rows = np.flatnonzero(self.flying)
        step_s: Array = (now_ns - self._time_ns[rows]).astype(np.float64) * 1e-9
        p0, v0 = self.position_m[rows], self.velocity_m_per_s[rows]
        wind = wind_m_per_s[rows]
        p1, v1 = self._step_flight(rows, p0, v0, wind, step_s)
        if self.solids is not None:
            down = self.solids.closes(p0, p1, self.radius_m)
            landed = rows[down]
            if landed.size:
                p1[down] = self._meet(
                    self.solids, landed, p0[down], v0[down], wind[down], step_s[down]
                )
            return self._moved(rows, landed, p1, v1, now_ns)
        bottom = plane_m[rows] + self.radius_m
        down = (p1[:, 2] <= bottom) & (v1[:, 2] < 0.0)
        landed = rows[down]
        if landed.size:
            # The step is at most 10 ms: drag changes the crossing time by microseconds.
            above = np.maximum(p0[down, 2] - bottom[down], 0.0)
            fall = v0[down, 2]
            touch_s = (fall + np.sqrt(fall**2 + 2.0 * GRAVITY_M_PER_S2 * above)) / GRAVITY_M_PER_S2
            touch_s = np.minimum(touch_s, step_s[down])
            p1[down], v1[down] = self._step_flight(landed, p0[down], v0[down], wind[down], touch_s)
            point = p1[down]
            point[:, 2] = plane_m[landed]
            self._touch(landed, point, touch_s)
        return self._moved(rows, landed, p1, v1, now_ns)

    def leave(self, now_ns: int, grip: GripMotion) -> None:
        """Let go of grains that are due, at most 2 ms after `grip`."""
        if self.grains is not None:
            self.grains.leave(self.release_ns, now_ns, grip)

    def _fly_grains(
        self, grains: GrainFlight, now_ns: int, plane_m: Array, wind_m_per_s: Array
    ) -> Landed:
        landed = grains.fly(now_ns, plane_m, wind_m_per_s, self.solids)
        rows = np.flatnonzero(self.flying)
        self.position_m[rows] = grains.centre_m()[rows]
        self.flying[landed.which] = False
        self.velocity_m_per_s[landed.which] = 0.0
        self.impact_m[landed.which], self.impact_ns[landed.which] = landed.centre_m, landed.time_ns
        volume_m3 = grains.measured_volume_m3(landed.which)
        return Landed(
            landed.which, landed.time_ns, landed.centre_m, volume_m3, landed.covariance_m2
        )

    def _meet(
        self,
        solids: Solids,
        landed: IntArray,
        position: Array,
        velocity: Array,
        wind: Array,
        step_s: Array,
    ) -> Array:
        """Centres (M, 3) of loads at their contact with a solid within this step."""

        def fly(share: Array) -> Array:
            return self._step_flight(landed, position, velocity, wind, share * step_s)[0]

        share = touch_share(lambda u: solids.distance(fly(u)) - self.radius_m, landed.size)
        centre = fly(share)
        self._touch(landed, solids.contact(centre, self.radius_m).point_m, share * step_s)
        return centre

    def _touch(self, landed: IntArray, point: Array, touch_s: Array) -> None:
        self.impact_m[landed] = point
        self.impact_ns[landed] = self._time_ns[landed] + (touch_s * 1e9).astype(np.int64)
        self.flying[landed] = False

    def _moved(
        self, rows: IntArray, landed: IntArray, position: Array, velocity: Array, now_ns: int
    ) -> Landed:
        self.position_m[rows], self.velocity_m_per_s[rows] = position, velocity
        self.velocity_m_per_s[landed] = 0.0
        self._time_ns[rows] = now_ns
        return Landed(landed, self.impact_ns[landed], self.impact_m[landed])

    def _step_flight(
        self, which: IntArray, position: Array, velocity: Array, wind: Array, step_s: Array
    ) -> tuple[Array, Array]:
        if self._faults is not None:
            return self._faults.fly(which, position, velocity, wind, step_s)
        return step_flight(position, velocity, self._drag_per_m, wind, step_s)

    def switch(self, now_ns: int) -> BoolArray:
        """Load switches of the grippers (N,): true until shortly after the release."""
        return self._switch_ns > now_ns

    def locate(self, grip: GripMotion, now_ns: int) -> None:
        """Move held loads to their grippers, at most 2 ms after `grip`."""
        held = self.held
        later_s = (now_ns - grip.time_ns) * 1e-9
        arm_m = np.einsum("nij,nj->ni", grip.rotation[held], self._offset_m[held])
        velocity = grip.velocity_m_per_s[held] + np.cross(grip.rate_rad_per_s[held], arm_m)
        self.position_m[held] = grip.position_m[held] + arm_m + velocity * later_s
        self.velocity_m_per_s[held] = velocity
