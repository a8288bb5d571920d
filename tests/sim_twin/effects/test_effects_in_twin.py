"""Every effect of the table in the twin: it acts at its stage and after, never before, and 0 is no effect."""

from typing import NamedTuple

import numpy as np
import pytest

from machine.conventions import CONTROL_PERIOD_NS, Array
from machine.starts import safe_pose
from runtime.driver import ValveCommand
from sim_twin.effects.effect import Effect
from sim_twin.effects.schema import DRIFT
from sim_twin.effects.sensor_effects import DelayLine
from sim_twin.effects.table import EFFECTS
from sim_twin.replay.replay import ReplayElement, ReplayOutput, replay
from sim_twin.twin.twin import Twin
from tests.sim_twin.twin_throw import CALIBRATION, PROFILE, SPEC, Recorded, record

CHANNELS = ("actuation", "swing", "imu", "release", "velocity", "impact")
UPSTREAM = {"actuation": 0, "swing": 1, "release": 3, "flight": 5}
"""Number of channels, in order, that an effect of a stage leaves alone."""


class Case(NamedTuple):
    effect: Effect

    @property
    def name(self) -> str:
        return f"{self.effect.effect}-{self.effect.joint}-{'-'.join(self.effect.parameters)}"


def large(low: float, high: float, step: float) -> float:
    """A size at which the effect shows beyond doubt."""
    return min(high, max(6.0 * step, 0.3 * high)) if high >= -low else low / 2


CASES = [
    Case(Effect(effect=name, joint=joint, parameters={p.name: large(p.low, p.high, p.step)}))
    for name, spec in EFFECTS.items()
    if name != DRIFT and not spec.is_random
    for joint in (spec.joints or (None,))
    for p in spec.parameters
]


@pytest.fixture(scope="module")
def plain() -> Recorded:
    return record()


@pytest.fixture(scope="module")
def outputs(plain: Recorded) -> ReplayOutput:
    """All cases, then no effect."""
    elements = [ReplayElement(0, (c.effect,)) for c in CASES] + [ReplayElement(0)]
    return replay([plain.replay_input], elements, PROFILE, CALIBRATION)


def changes(outputs: ReplayOutput, row: int) -> list[float]:
    """Largest change of each channel against no effect."""
    parts = (
        (outputs.joint_position_rad_m, outputs.joint_velocity_rad_m_per_s),
        (outputs.passive_position_rad, outputs.passive_velocity_rad_per_s),
        (outputs.gyro_rad_per_s, outputs.accel_m_per_s2),
        (outputs.release_t_s,),
        (outputs.release_velocity_m_per_s, outputs.release_position_m),
        (outputs.impact_m,),
    )
    return [
        max(float(np.nanmax(np.abs(array[row] - array[-1]))) for array in part) for part in parts
    ]


def acts_wrongly(effect: Effect, change: dict[str, float]) -> str:
    """What is wrong with the channels that an effect changes; empty if nothing is."""
    spec = EFFECTS[effect.effect]
    if spec.stage != "aim":
        before = [change[name] for name in CHANNELS[: UPSTREAM[spec.stage]]]
        # A gripper that swings otherwise pulls otherwise at drives of finite inertia.
        if max(before, default=0.0) > (1e-6 if spec.stage == "swing" else 0.0):
            return "changes a channel before its stage"
    if spec.part == "imu" or effect.effect == "joint_sensor_latency":
        if change["impact"] != 0.0:
            return "a sensor alone moves the impact in open loop"
        if not change["imu" if spec.part == "imu" else "actuation"] > 0.01:
            return "does not change what its sensor reports"
        return ""
    if not change["impact"] > 2e-3:
        return "does not move the impact"
    own = {"actuation": "actuation", "swing": "swing", "flight": "impact"}.get(spec.stage)
    if own is not None and spec.part != "grasp" and not change[own] > 1e-3:
        return "does not change the channel of its stage"
    return ""


def test_every_effect_acts_from_its_stage_on(outputs: ReplayOutput) -> None:
    wrong: list[str] = []
    for row, case in enumerate(CASES):
        change = dict(zip(CHANNELS, changes(outputs, row), strict=True))
        reason = acts_wrongly(case.effect, change)
        if reason:
            wrong.append(f"{case.name} {reason}: {change}")
    assert not wrong, "\n".join(wrong)


REPLAYS: dict[str, tuple[bool, bool, tuple[str, ...]]] = {
    "actuation": (False, False, ("joint_velocity_rad_m_per_s",)),
    "swing": (True, False, ("gyro_rad_per_s", "accel_m_per_s2")),
    "flight": (True, True, ("release_velocity_m_per_s", "impact_m")),
}
"""Measured driven joints, measured swing and opening, and the channels that are compared."""


def test_an_effect_shows_in_the_replays_of_its_row_only(plain: Recorded) -> None:
    wrong: list[str] = []
    shown: set[tuple[str, str | None]] = set()
    for replay_name, (joints, swing, channels) in REPLAYS.items():
        elements = [
            ReplayElement(0, effects, (joints,) * 4, measured_swing=swing, measured_opening=swing)
            for effects in [*((c.effect,) for c in CASES), ()]
        ]
        out = replay([plain.replay_input], elements, PROFILE, CALIBRATION)
        for row, case in enumerate(CASES):
            change = max(
                float(np.nanmax(np.abs(getattr(out, name)[row] - getattr(out, name)[-1])))
                for name in channels
            )
            if change < 1e-6:
                continue
            shown.add((case.effect.effect, case.effect.joint))
            if replay_name not in EFFECTS[case.effect.effect].replays:
                wrong.append(f"{case.name} changes the {replay_name} replay by {change:.2g}")
    assert not wrong, "\n".join(wrong)
    silent = {(c.effect.effect, c.effect.joint) for c in CASES} - shown
    assert {name for name, _ in silent} == {"release_delay"}, "compared with the switch alone"


def test_joint_effects_move_their_own_joint_only(outputs: ReplayOutput) -> None:
    for row, case in enumerate(CASES):
        effect = case.effect
        if EFFECTS[effect.effect].stage != "actuation" or effect.joint is None:
            continue
        moved = np.nanmax(
            np.abs(outputs.joint_position_rad_m[row] - outputs.joint_position_rad_m[-1]), axis=0
        )
        others = np.delete(moved, ("slew", "boom", "dipper", "telescope").index(effect.joint))
        # Through the drives' finite inertia another joint feels a billionth.
        assert others.max() < 1e-7, case.name


def test_a_size_of_zero_is_no_effect_to_the_last_bit(plain: Recorded) -> None:
    """Beside machines that do have the effect, so that its code runs."""
    real = [ReplayElement(0, (c.effect,)) for c in CASES]
    nothing = [
        ReplayElement(
            0,
            (c.effect.model_copy(update={"parameters": dict.fromkeys(c.effect.parameters, 0.0)}),),
        )
        for c in CASES[::7]
    ]
    mixed = replay([plain.replay_input], [*real, *nothing], PROFILE, CALIBRATION)
    alone = replay([plain.replay_input], [ReplayElement(0)], PROFILE, CALIBRATION)
    for name in ReplayOutput._fields:
        values, expected = getattr(mixed, name)[len(real) :], getattr(alone, name)
        np.testing.assert_array_equal(values, np.repeat(expected, len(nothing), axis=0), name)


def test_one_machine_equals_the_same_in_a_large_batch(
    plain: Recorded, outputs: ReplayOutput
) -> None:
    for row in range(0, len(CASES), 5):
        alone = replay(
            [plain.replay_input], [ReplayElement(0, (CASES[row].effect,))], PROFILE, CALIBRATION
        )
        for name in ReplayOutput._fields:
            np.testing.assert_array_equal(
                getattr(alone, name)[0], getattr(outputs, name)[row], CASES[row].name + name
            )


def closed_loop(effect: Effect, *, in_profile: bool) -> tuple[Array, Array]:
    """Readings and impact of a twin that is driven as campaigns and previews drive it."""
    profile = PROFILE.model_copy(update={"effects": (effect,)}) if in_profile else PROFILE
    twin = Twin(
        count=1,
        profile=profile,
        calibration=CALIBRATION,
        effects=None if in_profile else [(effect,)],
    )
    twin.reset(safe_pose()[None], 3)
    seen: list[Array] = []
    for tick in range(200):
        valve = np.array([[0.3 * np.sin(0.05 * tick), 0.2, -0.3, 0.2]]) * (tick < 90)
        twin.write(ValveCommand(valve, np.array([tick > 60])))
        twin.advance(twin.now_ns() + CONTROL_PERIOD_NS)
        sample = twin.read()
        seen.append(
            np.concatenate(
                [
                    sample.joint_position_rad_m[0],
                    sample.joint_velocity_rad_m_per_s[0],
                    sample.imu_gyro_rad_per_s[0],
                    sample.imu_accel_m_per_s2[0],
                ]
            )
        )
    return np.stack(seen), twin.true_impact_m()


def test_an_effect_of_the_profile_acts_as_one_of_the_machine() -> None:
    for case in CASES[::12]:
        in_profile, of_machine = (
            closed_loop(case.effect, in_profile=True),
            closed_loop(case.effect, in_profile=False),
        )
        np.testing.assert_array_equal(in_profile[0], of_machine[0], case.name)
        np.testing.assert_array_equal(in_profile[1], of_machine[1], case.name)
        assert np.isfinite(in_profile[1]).all(), case.name


def test_any_mixture_within_the_bounds_stays_finite(plain: Recorded) -> None:
    rng = np.random.default_rng(4)
    elements: list[ReplayElement] = []
    for number in range(60):
        mixture = [
            Effect(
                effect=name,
                joint=joint,
                parameters={p.name: float(rng.uniform(p.low, p.high)) for p in spec.parameters},
            )
            for name, spec in EFFECTS.items()
            if name != DRIFT
            for joint in (spec.joints or (None,))
            if rng.uniform() < 0.3
        ]
        measured = (number % 2 == 0,) * 4
        elements.append(ReplayElement(0, tuple(mixture), measured))
    out = replay([plain.replay_input], elements, PROFILE, CALIBRATION)
    for values in (out.joint_position_rad_m, out.passive_position_rad, out.gyro_rad_per_s):
        assert np.isfinite(values).all()
    low, high = SPEC.position_range_rad_m
    simulated = out.joint_position_rad_m[1::2]
    # As reported: a biased sensor may read beyond the stops.
    assert (simulated >= low - 0.081).all()
    assert (simulated <= high + 0.081).all()
    assert np.abs(out.gyro_rad_per_s).max() < 60.0


def through(values: Array, latency_s: float) -> Array:
    """Values (T,), one a tick, as a delay line reads them back."""
    line = DelayLine(np.array([[latency_s]]))
    line.fill(values[:1])
    late = np.empty_like(values)
    for tick, value in enumerate(values):
        line.push(np.array([[value]]))
        late[tick] = line.read()[0, 0]
    return late


def test_a_late_sensor_reads_a_parabola_as_it_was() -> None:
    t_s = 0.01 * np.arange(40)
    for latency_s in (0.0, 0.001, 0.005, 0.01, 0.0237):
        late = through(3.0 * t_s**2 - t_s, latency_s)
        then_s = t_s[6:] - latency_s
        np.testing.assert_allclose(late[6:], 3.0 * then_s**2 - then_s, atol=1e-12)


def test_a_late_sensor_keeps_rough_motion() -> None:
    """Else noise of the joint sensors would look like latency."""
    rough = np.sin(2.0 * np.pi * np.arange(400) / 12.0)
    for latency_s in (0.001, 0.003, 0.005):
        kept = np.std(through(rough, latency_s)[8:]) / np.std(rough[8:])
        assert kept == pytest.approx(1.0, abs=0.01), latency_s
