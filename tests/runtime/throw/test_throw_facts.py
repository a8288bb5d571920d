from dataclasses import replace

import numpy as np

from machine.calibration import nominal_calibration
from machine.conventions import Mode, Motion
from machine.spec import load_spec
from runtime.control import control_loop, safety
from runtime.control.control_loop import ControlInputs, ControlParams, Violation
from runtime.throw.facts import abort_reason, fault_reason, is_policys_own, with_control
from tests.cases import each
from tests.runtime.protocol_bench import FACTS
from tests.runtime.samples import NOW_NS, at_rest

SPEC = load_spec()


def outputs(motion=Motion.HOLD):
    params = ControlParams(SPEC, nominal_calibration(SPEC), Mode.PLANAR, None)
    target = np.array([[8.0, 0.0, 0.0]] * 2)
    sample = at_rest(2)
    state = control_loop.initial_state(params, sample, target, NOW_NS)
    inputs = ControlInputs(sample, np.full(2, int(motion)), target)
    return control_loop.step(params, state, inputs, NOW_NS)[1], sample


def test_the_facts_are_those_of_the_machine_asked_for():
    result, sample = outputs(Motion.SETTLE)
    flags = np.array([False, True])
    result = replace(
        result,
        aligned=flags,
        release_commanded=flags,
        throw_done=flags,
        load_gone=flags,
        settled=flags,
        violation_count=np.array([0, 2]),
    )
    result.row["safety_code_count"] = [0, 16]
    sample = replace(sample, payload_held=~flags, local_enable=~flags, emergency_stop=flags)
    first = with_control(FACTS, result, sample, 1.35)
    assert first.motion is Motion.SETTLE
    assert not any((first.aligned, first.release_commanded, first.throw_done, first.load_gone))
    assert (first.settled, first.emergency_stop) == (False, False)
    assert (first.payload_held, first.local_enable) == (True, True)
    assert (first.abort_reason, first.fault_reason) == ("", "")
    second = with_control(FACTS, result, sample, 1.35, 1)
    assert all((second.aligned, second.release_commanded, second.throw_done, second.load_gone))
    assert (second.settled, second.emergency_stop) == (True, True)
    assert (second.payload_held, second.local_enable) == (False, False)
    assert "1.35 rad" in second.abort_reason and "1.5 times" in second.fault_reason
    assert (second.cards, second.fresh_nonce) == (FACTS.cards, FACTS.fresh_nonce)


@each("bit", list(Violation))
def test_what_aborts(bit):
    words = {
        Violation.SWING: "swung",
        Violation.IMU: "IMU",
        Violation.POLICY: "policy",
        Violation.RELEASE: "refused",
        Violation.ZONE: "exclusion zone",
        Violation.LATE: "too long",
    }
    reason = abort_reason(int(bit), 1.35)
    # The gate has closed the valves itself; its own bits say why.
    assert (words[bit] in reason) if bit in words else reason == ""
    assert is_policys_own(int(bit)) is (bit in words and bit is not Violation.IMU)
    assert not is_policys_own(int(bit | Violation.IMU)), "without the IMU no policy can do well"


@each("bit", list(safety.Intervention))
def test_what_is_a_fault(bit):
    assert bool(fault_reason(int(bit))) is bool(bit & safety.LATCHING)


def test_fault_texts_differ():
    bits = (safety.Intervention.NOT_FINITE, safety.Intervention.STALE_SENSORS, 16)
    assert len({fault_reason(int(bit)) for bit in bits}) == 3
    assert "50 ms" in fault_reason(2)
    assert fault_reason(3) == fault_reason(1)
