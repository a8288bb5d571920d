"""Faults of valves and commands that the table of effects does not have (fault_tables.py)."""

import numpy as np

from machine.conventions import Array, BoolArray
from sim_twin.faults.fault import EffectSizes
from sim_twin.faults.fault_tables import UNLISTED_FAULTS


class UnlistedValveFaults:
    """Valves of N machines: drop-outs, command steps, fading hysteresis, changing gain, crosstalk."""

    def __init__(self, sizes: EffectSizes, step_s: float) -> None:
        self._step_s = step_s
        self._oscillation = sizes.joints("gain_oscillation", "amplitude_ratio")
        self._oscillation_rad_per_s = 2.0 * np.pi * sizes.joints("gain_oscillation", "frequency_hz")
        self._rate_per_s = sizes.machine("command_dropouts", "rate_per_s")
        self._length_s = sizes.machine("command_dropouts", "length_s")
        self._play = sizes.joints("fading_hysteresis", "half_width_ratio")
        self._travel = np.maximum(sizes.joints("fading_hysteresis", "travel_rad_m"), 1e-6)
        self._leak = sizes.joints("valve_crosstalk", "leak_ratio")
        self._zone_loss = sizes.joints("position_dependent_gain", "loss_ratio")
        self._width = np.maximum(sizes.joints("position_dependent_gain", "width_rad_m"), 1e-6)
        self._grain = sizes.joints("command_steps", "step_ratio")
        one = (sizes.count, 4)
        self._phase, self._travelled = np.zeros(one), np.zeros(one)
        self._middle, self._last = np.zeros(one), np.zeros(one)
        self._held, self._received = np.zeros(one), np.zeros(one)
        self._silent_s = np.zeros(sizes.count)
        self._rng = np.random.default_rng()

    @staticmethod
    def is_in(sizes: EffectSizes) -> bool:
        """Whether one of these faults is there."""
        return sizes.has(*(f.name for f in UNLISTED_FAULTS.values() if f.part == "drive"))

    def reset(self, position_rad_m: Array, seed: int) -> None:
        """A throw starts at active positions (N, 4)."""
        self._rng = rng = np.random.default_rng([seed, 0x5C])
        self._phase = rng.uniform(0.0, 2.0 * np.pi, self._phase.shape)
        self._travelled[:] = self._held[:] = self._received[:] = 0.0
        self._silent_s[:] = 0.0
        self._last[:] = position_rad_m
        # The zone of low gain lies a little way off the start, so that throws pass it at speed.
        self._middle = position_rad_m + np.where(position_rad_m > 0.3, -0.25, 0.25)

    def command(self, command_ratio: Array, position_rad_m: Array) -> Array:
        """What the valves receive (N, 4): held through drop-outs, in steps, with play that wears off."""
        chance = self._rng.random(self._silent_s.size)
        lost: BoolArray = (self._silent_s <= 0.0) & (chance < self._rate_per_s * self._step_s)
        self._silent_s = np.where(lost, self._length_s, self._silent_s - self._step_s)
        np.copyto(self._received, command_ratio, where=(self._silent_s <= 0.0)[:, None])
        received = self._received
        grain = self._grain
        if (grain > 0.0).any():
            steps = np.rint(received / np.maximum(grain, 1e-9)) * grain
            received = np.where(grain > 0.0, steps, received)
        self._travelled += np.abs(position_rad_m - self._last)
        self._last[:] = position_rad_m
        play = self._play * np.exp(-self._travelled / self._travel)
        self._held = np.clip(self._held, received - play, received + play)
        return np.where(self._play > 0.0, self._held, received)

    def meter(self, opening_ratio: Array, position_rad_m: Array, load_ratio: Array) -> None:
        """Change openings (2, N, 4) in place; loads (N, 4) in shares of the largest gravity moment."""
        self._phase += self._oscillation_rad_per_s * self._step_s
        # Pressure compensators oscillate more under more load.
        swing = self._oscillation * (0.4 + np.abs(load_ratio)) * np.sin(self._phase)
        away = (position_rad_m - self._middle) / self._width
        factor = (1.0 + swing) * (1.0 - self._zone_loss * np.exp(-(away**2)))
        if (self._leak != 0.0).any():
            # The pilot of the neighbouring valve leaks into this one.
            net = np.roll(opening_ratio[0] - opening_ratio[1], 1, axis=-1) * self._leak
            mine = opening_ratio[0] - opening_ratio[1] + net
            opening_ratio[0] = np.where(self._leak != 0.0, np.maximum(mine, 0.0), opening_ratio[0])
            opening_ratio[1] = np.where(self._leak != 0.0, np.maximum(-mine, 0.0), opening_ratio[1])
        opening_ratio *= np.maximum(factor, 0.0)
