"""Simulation loop of plant and control step for N machines, without a wall clock.

The control step is the one that runs on the machine.
"""

import numpy as np

from machine.conventions import CONTROL_PERIOD_NS, DEFAULT_PACE_RATIO, Array, IntArray, Motion
from machine.errors import PlantError
from runtime.control import control_loop
from runtime.control.control_loop import ControlInputs, ControlOutputs, ControlParams
from runtime.driver import SensorSample, SimulatedDriver


class Rollout:
    """One throw of each machine of a plant; a `tick` advances all of them by 10 ms."""

    def __init__(
        self,
        plant: SimulatedDriver,
        params: ControlParams,
        target_m: Array,
        start_rad_m: Array,
        seed: int,
        motion: Motion = Motion.THROW,
        pace_ratio: float = DEFAULT_PACE_RATIO,
    ) -> None:
        """Place the machines at their start poses, loaded and at rest.

        Args:
            plant: N = `count` machines.
            params: parameters of the control step.
            target_m: (N, 3) frame `machine`.
            start_rad_m: (N, 6) poses.
            seed: seed of the plant's random numbers.
            motion: first motion.
            pace_ratio: pace of every throw, 0 careful .. 1 fast.

        Raises:
            PlantError: the number of targets or starts differs from that of the machines.
        """
        if target_m.shape != (plant.count, 3) or start_rad_m.shape != (plant.count, 6):
            raise PlantError(
                f"the plant has {plant.count} machines, but there are targets of shape "
                f"{target_m.shape} and starts of shape {start_rad_m.shape}"
            )
        self.plant, self.params, self.target_m = plant, params, target_m
        self._pace_ratio = pace_ratio
        plant.reset(start_rad_m, seed)
        self.start_ns = plant.now_ns()
        self.motion: IntArray = np.full(plant.count, int(motion), dtype=np.int64)
        self.sample: SensorSample = plant.read()
        self._state = control_loop.initial_state(params, self.sample, target_m, self.start_ns)

    @property
    def elapsed_s(self) -> float:
        """Simulated time since the start."""
        return (self.plant.now_ns() - self.start_ns) * 1e-9

    def tick(self) -> ControlOutputs:
        """Run the control step on the present sample, advance one period, read the next sample."""
        now_ns = self.plant.now_ns()
        inputs = ControlInputs(self.sample, self.motion, self.target_m, self._pace_ratio)
        self._state, outputs = control_loop.step(self.params, self._state, inputs, now_ns)
        self.plant.write(outputs.command)
        self.plant.advance(now_ns + CONTROL_PERIOD_NS)
        if self.plant.now_ns() != now_ns + CONTROL_PERIOD_NS:
            raise PlantError(
                f"asked to advance to {now_ns + CONTROL_PERIOD_NS} ns, the plant's clock says "
                f"{self.plant.now_ns()} ns; a simulated plant must follow `advance` exactly"
            )
        self.motion = control_loop.next_motion(self.motion, outputs)
        self.sample = self.plant.read()
        return outputs
