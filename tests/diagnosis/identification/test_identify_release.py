"""The release delay is found with and without a tracker, and separated from the switch's latch."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.identification.plots import release_figure
from diagnosis.identification.profile_update import next_profile, with_release
from diagnosis.identification.release_delay import identify_release
from sim_twin.commissioning.motions import RELEASE_COUNT
from sim_twin.twin.profile import nominal_profile
from sim_twin.virtual.units import make_unit
from tests.diagnosis.identification.recorded_tests import SPEC, recorded

UNIT = 7


@pytest.fixture(scope="module")
def throws():
    return recorded("release", UNIT, 5)


@pytest.fixture(scope="module")
def found(throws):
    return identify_release(throws, SPEC)


def test_39_openings_recover_the_units_delay_and_scatter(found):
    unit = make_unit(SPEC, UNIT)
    assert found.method == "tracker"
    assert found.mean.count == RELEASE_COUNT
    assert found.mean.value == pytest.approx(unit.release_delay_s, abs=0.006)
    assert found.sd.value == pytest.approx(unit.release_delay_sd_s, rel=0.35)
    low, high = found.mean.ci90
    # Student's half width of 39 openings that scatter by 13 to 20 ms.
    assert 0.002 < 0.5 * (high - low) < 0.006


def test_the_latch_of_the_switch_is_measured_apart_from_the_delay(found):
    low, high = found.latch.ci90
    assert low - 0.003 < 0.0275 < high + 0.003
    assert found.latch.spread == pytest.approx(0.025 / np.sqrt(12.0), rel=0.6)


def test_without_a_tracker_the_latch_stays_in_the_interval(throws, found):
    blind = tuple(replace(t, ball_t_s=np.zeros(0), ball_m=np.zeros((0, 3))) for t in throws)
    other = identify_release(blind, SPEC)
    assert other.method == "switch"
    assert other.latch.value is None
    assert "cannot be known" in other.latch.why
    assert other.mean.value == pytest.approx(found.mean.value, abs=0.006)
    width = other.mean.ci90[1] - other.mean.ci90[0]
    assert width > found.mean.ci90[1] - found.mean.ci90[0] + 0.02
    assert other.sd.value == pytest.approx(found.sd.value, rel=0.3)


def test_two_openings_are_too_few(throws):
    few = identify_release(throws[:2], SPEC)
    assert few.mean.value is None
    assert "3 are needed" in few.mean.why
    assert next_profile(nominal_profile(SPEC), with_release(few), "m", "n") is None


def test_the_next_profile_has_the_delay_with_its_interval(found):
    before = nominal_profile(SPEC)
    after = next_profile(before, with_release(found), "m007", "openings")
    assert after.version_count == before.version_count + 1
    assert after.release_delay_s == found.mean.value
    assert after.intervals["release_delay_s"] == found.mean.ci90
    assert after.dead_time_s == before.dead_time_s


def test_the_histogram_names_the_papers_figures(found):
    figure = release_figure(found, "unit 7")
    words = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert any("paper, 39 releases: 258 ± 15 ms" in w for w in words)
