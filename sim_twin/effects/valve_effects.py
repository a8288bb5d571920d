"""Effects between valve command and joint motion, for N machines at once.

Extends sim_twin.twin.response at five places: the command, the steady speed, its limits, the motion behind
the lag, and the joint behind that. Every line leaves a machine without the effect exactly as it was.
"""

import math
from typing import NamedTuple

import numpy as np

from machine.conventions import ACTIVE_COUNT, CONTROL_PERIOD_S, Array
from machine.spec import MachineSpec
from sim_twin.effects.arrays import EffectArrays
from sim_twin.lag import first_order
from sim_twin.rigid_body.arm_load import gravity_load_ratio

MIN_LAG_S = 0.01
"""A mean lag cannot be taken away beyond this: one control tick."""
STOP_SHARE_RATIO = 0.1
"""A joint slower than this share of its breakaway speed, with too small a command, has stopped."""
STANDING_RAD_M_PER_S = 0.005
"""A joint that is measured to be slower over a tenth of a second stands: twice what sensors scatter then."""
SLIP_S = 0.02
"""Time constant of two relaxations: of a drive's push while it crosses its play, and of a joint's speed
towards its drive's after the joint breaks loose."""


class Flows(NamedTuple):
    """Oil a drive takes, m3 per m or rad of its actuator."""

    positive_m2: Array
    """(4,) in the joint's positive direction; the slew's in m3/rad."""
    negative_m2: Array


def drive_flows(spec: MachineSpec) -> Flows:
    """Piston areas; the dipper's cylinder retracts as the joint opens."""
    h = spec.hydraulics

    def areas(bore_m: float, rod_m: float) -> tuple[float, float]:
        return 0.25 * np.pi * bore_m**2, 0.25 * np.pi * (bore_m**2 - rod_m**2)

    boom_out, boom_in = areas(h.boom_cylinder.bore_m, h.boom_cylinder.rod_m)
    dipper_out, dipper_in = areas(h.dipper_cylinder.bore_m, h.dipper_cylinder.rod_m)
    tube_out, tube_in = areas(h.telescope_bore_m, h.telescope_rod_m)
    slew = h.slew_displacement_m3_per_rad
    return Flows(
        np.array([slew, boom_out, dipper_in, tube_out]),
        np.array([slew, boom_in, dipper_out, tube_in]),
    )


class ValveEffects:
    """Effects of the stage `actuation`; arrays (N, 4)."""

    def __init__(self, spec: MachineSpec, arrays: EffectArrays) -> None:
        """Look up what any of the machines has."""
        self._spec = spec
        get = arrays.get
        shape = (arrays.count, ACTIVE_COUNT)
        self.dead_time_s = get("valve_dead_time", "extra_dead_time_s")
        self._lag_s = get("valve_lag", "extra_lag_s")
        self._decay, self._mean = _first_order(self._lag_s)
        self._half_width = get("valve_hysteresis", "half_width_ratio")
        self._band = _directions(arrays, "valve_dead_band")
        self._gain = _directions(arrays, "valve_gain")
        self._reduction = get("speed_limit", "reduction_ratio")
        self._loss = get("load_dependent_speed", "loss_ratio")
        self._shortage = get("pump_flow_sharing", "shortage_ratio")
        self._breakaway = get("stiction", "breakaway_rad_m_per_s")
        self._gap = get("backlash", "gap_rad_m")
        self._flows = drive_flows(spec)
        self._rated = (
            np.asarray(spec.limits.speed_positive_rad_m_per_s),
            np.asarray(spec.limits.speed_negative_rad_m_per_s),
        )
        self._spool, self._lagging = np.zeros(shape), np.zeros(shape)
        self._lost, self._free = np.zeros(shape), np.zeros(shape, dtype=np.bool_)
        self._anywhere = np.zeros(shape, dtype=np.bool_)
        self._slope_before = np.zeros(shape)
        self._at_rest = np.ones(shape, dtype=np.bool_)
        self._behind, self._joint = np.zeros(shape), np.zeros(shape)
        self._is_fresh = True
        self._seen_before, self._push = np.zeros(shape), np.zeros(shape)
        self._mean_lag_s = np.zeros(shape)

    @property
    def has_play(self) -> bool:
        """Whether a machine has joints that hang in the play of their drives."""
        return self._gap is not None

    def reset(self) -> None:
        """Spools centred, joints at rest, drives against the side of their gaps that carries the load."""
        self._spool[:] = 0.0
        self._lagging[:] = 0.0
        self._slope_before[:] = 0.0
        self._is_fresh = True
        self._at_rest[:] = True
        self._behind[:] = 0.0
        self._push[:] = 0.0
        # What came from a caller, or went to one, is not ours to clear.
        self._joint, self._seen_before = np.zeros_like(self._push), np.zeros_like(self._push)

    def frequency(self, natural_frequency_rad_per_s: Array, damping_ratio: Array) -> Array:
        """Natural frequencies whose mean lag 2 z / w is shorter by an extra lag below 0.

        Longer lags are a first-order lag of the spool (`on_command`).
        """
        self._mean_lag_s = 2.0 * damping_ratio / natural_frequency_rad_per_s
        if self._lag_s is None:
            return natural_frequency_rad_per_s
        lag = self._mean_lag_s
        faster = 2.0 * damping_ratio / np.maximum(lag + self._lag_s, np.minimum(lag, MIN_LAG_S))
        return np.where(self._lag_s >= 0.0, natural_frequency_rad_per_s, faster)

    def valve_lag(self, valve_lag_s: Array, mean_lag_s: Array) -> Array:
        """Lags (N, 4) of the valves before oil springs, shorter by an extra lag below 0.

        Args:
            valve_lag_s: without effects.
            mean_lag_s: of the valve, the oil and the joint together.
        """
        self._mean_lag_s = np.broadcast_to(mean_lag_s, self._push.shape)
        if self._lag_s is None:
            return valve_lag_s
        return np.maximum(valve_lag_s + np.minimum(self._lag_s, 0.0), 0.0)

    def on_command(self, valve_ratio: Array) -> Array:
        """What the spools make of valve commands: play, then lag, then overlap."""
        if self._half_width is not None:
            w = self._half_width
            self._spool = np.clip(self._spool, valve_ratio - w, valve_ratio + w)
            valve_ratio = self._spool
        if self._decay is not None:
            behind = self._lagging - valve_ratio
            self._lagging = valve_ratio + self._decay * behind
            # The mean over the tick, which the response holds.
            valve_ratio = valve_ratio + self._mean * behind
        if self._band is not None:
            band = np.where(valve_ratio >= 0.0, *self._band)
            valve_ratio = np.sign(valve_ratio) * np.maximum(np.abs(valve_ratio) - band, 0.0)
        return valve_ratio

    def on_speed(self, actuator_speed_rad_m_per_s: Array) -> Array:
        """Steady actuator speeds with the valves' gains."""
        if self._gain is None:
            return actuator_speed_rad_m_per_s
        gain = np.where(actuator_speed_rad_m_per_s >= 0.0, *self._gain)
        return actuator_speed_rad_m_per_s * (1.0 + gain)

    def on_target(self, target: Array, active_position_rad_m: Array, ratio: Array) -> Array:
        """Steady joint speeds as load, pump and limits leave them.

        Args:
            target: joint speeds asked for.
            active_position_rad_m: joints.
            ratio: actuator speed a joint speed.
        """
        if self._loss is not None:
            load = gravity_load_ratio(self._spec, active_position_rad_m)
            target = target * np.maximum(1.0 - self._loss * load * np.sign(target), 0.0)
        if self._shortage is not None:
            target = target * self._share(target * ratio, self._shortage)[:, None]
        if self._reduction is not None:
            speed = np.abs(target)
            rated = np.where(target >= 0.0, *self._rated)
            cap = (1.0 - self._reduction) * np.maximum(rated, speed)
            target = np.sign(target) * np.minimum(speed, cap)
        return target

    def _share(self, actuator_speed: Array, shortage: Array) -> Array:
        """Share (N,) of the flow asked for that is left, over what a healthy pump would give."""
        areas = np.where(actuator_speed >= 0.0, *self._flows)
        demand = np.maximum((np.abs(actuator_speed) * areas).sum(axis=1), 1e-12)
        healthy = np.minimum(self._spec.hydraulics.pump_flow_m3_per_s / demand, 1.0)
        flow = (1.0 - shortage) * self._spec.hydraulics.pump_flow_m3_per_s
        return np.minimum(flow / demand, 1.0) / healthy

    def on_motion(
        self,
        target: Array,
        before: Array,
        velocity: Array,
        slope: Array,
        active_position_rad_m: Array,
        seen: Array | None = None,
    ) -> tuple[Array, Array]:
        """Drive velocity and its slope with joints that hang in the play of their drives.

        Args:
            target: steady speed asked for.
            before: velocity a tick ago.
            velocity: what the lag makes of both.
            slope: the lag's second state.
            active_position_rad_m: joints.
            seen: measured velocity, which then says on which side of its play the slew begins.
        """
        if self._gap is None:
            return velocity, slope
        return self._cross(self._gap, target, before, velocity, slope, active_position_rad_m, seen)

    def on_joint(self, target: Array, velocity: Array, seen: Array | None = None) -> Array:
        """Joint velocity of joints that stick. Valve and oil go on behind one that stands.

        Breaking loose it comes up with them as oil that was compressed lets it: soon.

        Args:
            target: steady speed asked for.
            velocity: what drive and lag make of it.
            seen: measured velocity, which then says when a joint that sticks comes to rest.
        """
        if self._breakaway is None:
            return velocity
        # What pushes follows the valve as late as the motion does.
        share = np.exp(-CONTROL_PERIOD_S / np.maximum(self._mean_lag_s, 1e-6))
        self._push = target + share * (self._push - target)
        small = (self._breakaway > 0.0) & (np.abs(self._push) <= self._breakaway)
        self._behind *= math.exp(-CONTROL_PERIOD_S / SLIP_S)
        joint = velocity + self._behind
        if seen is None:
            slow = np.abs(joint) < STOP_SHARE_RATIO * self._breakaway
            stops = slow | (self._joint * joint <= 0.0)
        else:
            stops = (np.abs(seen) < STANDING_RAD_M_PER_S) | (self._seen_before * seen <= 0.0)
            self._seen_before = seen
        self._at_rest = small & (self._at_rest | stops)
        self._behind = np.where(self._at_rest, -velocity, self._behind)
        self._joint = np.where(self._at_rest, 0.0, joint)
        return self._joint

    def _cross(
        self,
        gap: Array,
        target: Array,
        before: Array,
        velocity: Array,
        slope: Array,
        active_position_rad_m: Array,
        seen: Array | None,
    ) -> tuple[Array, Array]:
        """Velocity and slope of joints whose drives may be crossing their play.

        What lags is the arm on its oil. A drive alone in its play runs at the steady speed at once, the joint
        stays where it came to rest, and moves off from rest when the drive meets it again. Nothing loads the
        slew, which starts in the middle of its play, or where the measured velocity says.
        """
        half = 0.5 * gap
        if self._is_fresh:
            load = gravity_load_ratio(self._spec, active_position_rad_m)
            self._lost, self._is_fresh = np.sign(load) * half, False
            self._free = (half > 0.0) & (load == 0.0)
            self._anywhere = self._free & (seen is not None)
        side = np.sign(self._lost)
        leaves = ~self._free & (side * target < 0.0) & (side * velocity < 0.0) & (half > 0.0)
        # The joint comes to rest within the tick; the rest of the tick is the drive's.
        swing = np.abs(velocity) + np.maximum(side * before, 0.0)
        share = np.where(leaves, np.abs(velocity) / np.maximum(swing, 1e-12), 1.0)
        free = self._free | leaves
        lost = self._lost + np.where(free, target * share * CONTROL_PERIOD_S, 0.0)
        over = np.abs(lost) - np.where(self._anywhere, gap, half)
        arrived = free & (over >= 0.0)
        if seen is not None:
            arrived |= self._anywhere & (seen * np.sign(lost) > STANDING_RAD_M_PER_S)
            self._anywhere &= ~arrived
        used = over / np.maximum(np.abs(target) * share * CONTROL_PERIOD_S, 1e-12)
        moved = np.where(arrived, np.clip(used, 0.0, 1.0), np.where(free, 0.0, 1.0))
        self._free = free & ~arrived
        reach = np.where(self._anywhere, gap, half)
        self._lost = np.clip(lost, -reach, reach)
        eased = np.where(free, math.exp(-CONTROL_PERIOD_S / SLIP_S), 1.0)
        resting = self._slope_before * np.where(self._free, eased, 1.0)
        changed = np.where(
            self._free, resting, self._slope_before + moved * (slope - self._slope_before)
        )
        self._slope_before = np.where(half > 0.0, changed, 0.0)
        return velocity * moved, np.where(half > 0.0, changed, slope)


def _first_order(lag_s: Array | None) -> tuple[Array | None, Array]:
    """What is left of a first-order lag's error after a tick, and its mean over the tick; shapes (N, 4)."""
    if lag_s is None or not (lag_s > 0.0).any():
        return None, np.zeros(0)
    return first_order(lag_s)


def _directions(arrays: EffectArrays, effect: str) -> tuple[Array, Array] | None:
    """Sizes in the positive and in the negative direction."""
    up, down = arrays.get(effect, "positive_ratio"), arrays.get(effect, "negative_ratio")
    if up is None and down is None:
        return None
    none = np.zeros((arrays.count, ACTIVE_COUNT))
    return none if up is None else up, none if down is None else down
