"""Property ablation: planted properties are found, whether they act alone, together, or not at all."""

from dataclasses import fields

import numpy as np
import pytest

from evaluation.accuracy_report.accuracy_page import accuracy_html
from evaluation.campaigns import CampaignOptions, open_with
from evaluation.conditions import condition_row
from evaluation.execution.executor import LocalProcesses
from evaluation.measures import Estimate, ModeEvaluation, UnitRow
from evaluation.property_ablation import WidestUnit, ablate_properties, property_ablation
from evaluation.requirements import find_widest
from machine.calibration import nominal_calibration
from machine.spec import load_spec
from sim_twin.throws.campaign import ThrowOutcome, ThrowResult
from sim_twin.twin.twin import Twin
from sim_twin.virtual.properties import PROPERTIES, as_drawn
from sim_twin.virtual.units import MachineUnit, make_unit, nominal_unit

SPEC = load_spec()
CHOSEN = WidestUnit(44313, 8.5, "downrange", 0.08, 0.05)


def throws(down, cross=None, lost=()):
    cross = np.zeros(len(down)) if cross is None else cross
    return [
        ThrowResult((8.5, 0.0, 0.0), ThrowOutcome.COLLISION if i in lost else ThrowOutcome.LANDED, (0.0,) * 3,
                    float(d), float(c), 3.0, 1.5, 3.0)
        for i, (d, c) in enumerate(zip(down, cross, strict=True))
    ]  # fmt: skip


def part(wide=None, units=()):
    return ModeEvaluation(
        mode="2d", plant="virtual", unit_seed=0, policy="p", seed=1, seconds=1.0, real_time_factor=9.0,
        outcomes={}, targets=(), start_to_release_s=Estimate(value=None, ci95=None),
        start_to_landing_s=Estimate(value=None, ci95=None), failures=(), sensitivity_range_m=None,
        sensitivity=(), sensitivity_note="", wide_unit=wide, units=units,
    )  # fmt: skip


def page(evaluation):
    return accuracy_html([evaluation], SPEC.static_reach_m)


def planted(count=400):
    """Chance and three independent causes of a miss, m."""
    return 0.04 * np.random.default_rng(1).standard_normal((4, count))


def test_a_property_that_acts_by_itself_has_its_share():
    chance, a, b, _ = planted()
    wide = property_ablation(
        CHOSEN, throws(chance + a + b), throws(chance),
        {"half of a": throws(chance + a / 2 + b), "b": throws(chance + a),
         "nothing": throws(chance + a + b)},
    )  # fmt: skip
    shares = {row.name: row.share_ratio for row in wide.properties}
    assert shares["b"] == pytest.approx(0.5, abs=0.1)
    # Half the deviation is three quarters of the variance.
    assert shares["half of a"] == pytest.approx(0.375, abs=0.1)
    assert shares["nothing"] == 0.0
    assert [row.name for row in wide.properties][-1] == "nothing"
    assert wide.single_sum_ratio == pytest.approx(0.875, abs=0.15)
    text = page(part(wide))
    assert "Whether several must coincide does not show" in text
    assert f"b ({100 * shares['b']:.0f} %)" in text and "nothing (" not in text
    assert f"{wide.drawn_sd_m:.3f} m</b> with every property nominal" in text


def test_what_is_there_only_where_several_meet_adds_up_to_more_than_all():
    chance, a, _, _ = planted()
    one = throws(chance)
    wide = property_ablation(CHOSEN, throws(chance + 2 * a), one, {"lengths": one, "lag": one})
    assert wide.single_sum_ratio == pytest.approx(2.0)
    assert "several properties must coincide" in page(part(wide))


def test_where_one_of_several_is_enough_the_sum_is_less_than_all():
    chance, a, _, _ = planted()
    still = throws(chance + 2 * a)
    wide = property_ablation(CHOSEN, still, throws(chance), {"lengths": still, "lag": still})
    assert wide.single_sum_ratio == pytest.approx(0.0)
    assert "one of several properties suffices" in page(part(wide))


def test_a_machine_that_was_only_unlucky_is_called_that():
    chance, other, _, _ = planted()
    wide = property_ablation(CHOSEN, throws(chance), throws(other), {"lengths": throws(other)})
    assert wide.single_sum_ratio is None
    assert wide.properties[0].share_ratio is None
    text = page(part(wide))
    assert "by chance" in text
    # A share of nothing is no column.
    assert "share of the added variance" not in text and ">sum<" not in text


def test_the_way_is_the_chosen_one_and_throws_that_failed_are_counted():
    chance, a, _, _ = planted()
    across = CHOSEN._replace(direction="crossrange")
    wide = property_ablation(
        across, throws(chance, chance + a), throws(chance, chance, lost=(3,)),
        {"lengths": throws(chance, chance, lost=(5, 6))},
    )  # fmt: skip
    assert wide.pair_count == 397
    assert wide.properties[0].failed_count == 2
    assert wide.sd_m > wide.drawn_sd_m
    assert "crossrange at 8.5 m" in page(part(wide))
    assert property_ablation(across, *[throws(chance, lost=range(399))] * 2, {}) is None
    assert "Why a machine scatters more" not in page(part())


def test_the_widest_is_nearest_to_a_factor_asked_for():
    def unit(seed, sd_7, sd_9):
        rows = [condition_row(r, 0.0, 0.0, throws((-s, s))) for r, s in ((7.5, sd_7), (9.0, sd_9))]
        pooled = float(np.hypot(sd_7, sd_9))
        return UnitRow(unit_seed=seed, landed_count=4, throw_count=4, mean_downrange_error_m=0.0,
                       sd_downrange_m=pooled, mean_crossrange_error_m=0.0, sd_crossrange_m=None,
                       targets=tuple(rows))  # fmt: skip

    beside = find_widest(
        part(units=(unit(0, 0.02, 0.03), unit(7, 0.03, 0.02), unit(8, 0.04, 0.05)))
    )
    assert (beside.unit_seed, beside.range_m, beside.direction) == (8, 7.5, "downrange")
    assert beside.sd_m == pytest.approx(2.0 * beside.nominal_sd_m)
    asked = find_widest(part(units=(unit(0, 0.2, 0.2), unit(7, 0.1, 0.1), unit(8, 0.1, 0.19))))
    assert (asked.unit_seed, asked.range_m) == (8, 9.0)
    assert find_widest(part()) is None


def test_every_difference_between_machines_is_one_property():
    named = [name for names in PROPERTIES.values() for name in names]
    assert sorted(named) == sorted(f.name for f in fields(MachineUnit) if f.name != "unit_seed")
    built = make_unit(SPEC, 12)
    drawn = as_drawn(SPEC, built, PROPERTIES)
    assert drawn.unit_seed == 12
    assert all(getattr(drawn, n) == getattr(nominal_unit(SPEC), n) for n in named)
    one = as_drawn(SPEC, built, ("lengths",))
    changed = {n for n in named if getattr(one, n) != getattr(built, n)}
    assert changed == set(PROPERTIES["lengths"])


def test_each_run_is_of_its_own_machine(swing_policies, monkeypatch):
    """Stand-ins calibrate, register and throw: hundreds of throws are not for a quick test."""
    seen: list[str] = []
    built = make_unit(SPEC, 5)
    expected = {
        "built": built,
        "drawn": as_drawn(SPEC, built, PROPERTIES),
        **{name: as_drawn(SPEC, built, [name]) for name in PROPERTIES},
    }
    chance, a, _, _ = planted(20)

    def machine(unit, count):
        seen.extend(name for name, own in expected.items() if own == unit)
        return Twin.for_plant(count=1, unit_seed=0)

    def throw(campaign, count, seed):
        campaign.make(1).close()
        assert (campaign.places, count, seed) == ([(6.0, 0.0)], 20, 2)
        return [throws(chance + a if seen[-1] == "built" else chance)]

    options = CampaignOptions("virtual", None, 20, 1, 0, swing_policies, None, None, None)
    campaign = open_with(options._replace(plant="twin"), "2d", "6")
    monkeypatch.setattr(
        "evaluation.property_ablation.open_with", lambda options, mode, default: campaign
    )
    monkeypatch.setattr("evaluation.property_ablation._machine", machine)
    monkeypatch.setattr(
        "evaluation.property_ablation.calibrate", lambda *_: nominal_calibration(SPEC)
    )
    monkeypatch.setattr(
        "evaluation.property_ablation.register_campaign", lambda campaign, seed: campaign
    )
    monkeypatch.setattr("evaluation.property_ablation.throw_campaign", throw)
    wide = ablate_properties(
        "2d", options, CHOSEN._replace(unit_seed=5, range_m=6.0), LocalProcesses()
    )
    # Each machine twice: its valves are measured, and it throws.
    assert seen == [name for name in expected for _ in range(2)]
    assert wide.unit_seed == 5
    assert wide.gain_m > 0.0
