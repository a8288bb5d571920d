"""Run identification tests on a simulated machine and record them as throw logs.

The runtime's control step runs in parallel for its estimates; the valves follow the test's program.
"""

from dataclasses import replace

import numpy as np

from machine.conventions import CONTROL_PERIOD_NS, CONTROL_PERIOD_S, Motion
from machine.kinematics import grip_centre
from machine.telemetry import POLICY_ROW
from runtime.control import control_loop
from runtime.control.control_loop import ControlInputs, ControlParams
from runtime.driver import SimulatedDriver, ValveCommand
from sim_twin.commissioning.motions import MotionProgram
from sim_twin.throws.campaign import ThrowOutcome, ThrowResult, TickRecorder, throw_errors

AFTER_OPENING_S = 2.5
"""Time after the opening command for delay, fall and survey."""


def record_test(
    plant: SimulatedDriver,
    params: ControlParams,
    program: MotionProgram,
    seed: int,
    record: TickRecorder,
) -> list[ThrowResult]:
    """Run one program; the load that it drops at its end gives the log's impact.

    Args:
        plant: with as many machines as the program.
        params: parameters of the control step that runs in parallel; no policy needed.
        program: commands.
        seed: seed of the plant's noise.
        record: writer of the logs.
    """
    count, rows = plant.count, program.valve_ratio.shape[0]
    nothing = np.zeros_like(program.start_rad_m)
    target_m = grip_centre(params.spec, program.start_rad_m, nothing).position_m.copy()
    target_m[:, 2] = 0.0
    plant.reset(program.start_rad_m, seed)
    record.begin(plant, 0, count)
    start_ns, sample = plant.now_ns(), plant.read()
    state = control_loop.initial_state(params, sample, target_m, start_ns)
    hold = np.full(count, int(Motion.HOLD), dtype=np.int64)
    unused_policy_row = np.zeros(count, dtype=POLICY_ROW)
    ticks = rows + round(AFTER_OPENING_S / CONTROL_PERIOD_S)
    for tick in range(ticks):
        now_ns = plant.now_ns()
        inputs = ControlInputs(sample, hold, target_m)
        state, outputs = control_loop.step(params, state, inputs, now_ns)
        shut = np.zeros_like(program.valve_ratio[0])
        valve = program.valve_ratio[tick] if tick < rows else shut
        opens = tick * CONTROL_PERIOD_S >= program.open_s - 1e-9
        plant.write(ValveCommand(valve, opens))
        plant.advance(now_ns + CONTROL_PERIOD_NS)
        sample = plant.read()
        # Readers of logs start at the first row whose motion is THROW.
        outputs.row["motion_code_count"] = int(Motion.THROW)
        outputs.row["valve_requested_ratio"] = outputs.row["valve_applied_ratio"] = valve
        outputs.row["velocity_request_rad_m_per_s"] = 0.0
        outputs.row["velocity_reference_rad_m_per_s"] = 0.0
        outputs.row["gripper_open_commanded"] = opens
        record.tick(now_ns, sample, replace(outputs, policy_row=unused_policy_row))
    landed = sample.impact_t_mono_ns > start_ns
    down, cross = throw_errors(sample.impact_position_m, target_m)
    results = [
        ThrowResult(
            target_m=tuple(target_m[i].tolist()),
            outcome=ThrowOutcome.LANDED if landed[i] else ThrowOutcome.TIMEOUT,
            impact_m=tuple(sample.impact_position_m[i].tolist()),
            downrange_error_m=float(down[i]),
            crossrange_error_m=float(cross[i]),
            release_speed_m_per_s=0.0,
            throw_duration_s=float(program.open_s[i]),
            simulated_s=ticks * CONTROL_PERIOD_S,
        )
        for i in range(count)
    ]
    record.end(results)
    return results
