"""The loop of every simulation: plant, control step, next motion; N machines at once, no wall clock.

The control step is the one that runs on the machine; nothing here decides what the machine does.
"""

import numpy as np

from machine.conventions import CONTROL_PERIOD_NS, DEFAULT_PACE_RATIO, Array, IntArray, Motion
from machine.errors import PlantError
from runtime.control import control_loop
from runtime.control.control_loop import ControlInputs, ControlOutputs, ControlParams
from runtime.driver import SensorSample, SimulatedDriver


class Rollout:
    """Machines of a plant on their way through one throw each; one `tick` is 10 ms of all of them."""

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
        """Put the machines at their starts, loaded and at rest.

        Args:
            plant: the machines; its `count` is N.
            params: what the control step needs.
            target_m: (N, 3) frame `machine`.
            start_rad_m: (N, 6) poses.
            seed: of the plant's per-throw noise.
            motion: what the machines do first.
            pace_ratio: of every throw, 0 careful .. 1 fast.

        Raises:
            PlantError: targets and starts are not as many as the plant's machines.
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
        """Control with the present sample, move on by one period, read the next sample."""
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
