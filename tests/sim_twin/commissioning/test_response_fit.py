"""Response fits recover what was put in, under noise, and refuse what holds nothing."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_twin.commissioning.response_fit import fit_response, simulate_response


def random_steps(rng, runs=6, ticks=400):
    return np.repeat(rng.uniform(-0.4, 0.4, (runs, ticks // 25)), 25, axis=1)


@settings(max_examples=4, deadline=None)
@given(
    st.floats(0.02, 0.25),
    st.floats(3.0, 15.0),
    st.floats(0.4, 1.2),
    st.floats(0.8, 1.2),
    st.integers(0, 99),
)
def test_the_parameters_come_back(dead_time_s, frequency, damping, gain, seed):
    rng = np.random.default_rng(seed)
    command = random_steps(rng)
    clean = simulate_response(command, dead_time_s, frequency, damping, gain)
    fit = fit_response(command, clean + rng.normal(0.0, 0.005, clean.shape))
    assert fit.dead_time_s == pytest.approx(dead_time_s, abs=0.01)
    assert fit.natural_frequency_rad_per_s == pytest.approx(frequency, rel=0.1)
    assert fit.damping_ratio == pytest.approx(damping, rel=0.12)
    assert fit.gain_ratio == pytest.approx(gain, rel=0.03)
    assert fit.r2_ratio > 0.98


def test_what_the_model_lacks_lowers_r2():
    rng = np.random.default_rng(1)
    command = random_steps(rng)
    dead_band = np.where(np.abs(command) > 0.2, command, 0.0)
    whole = fit_response(command, simulate_response(command, 0.1, 8.0, 0.7, 1.0))
    fit = fit_response(command, simulate_response(dead_band, 0.1, 8.0, 0.7, 1.0))
    assert fit.r2_ratio < whole.r2_ratio - 0.01
    assert fit.residual_rad_m_per_s > 0.01


def test_a_constant_command_is_refused():
    with pytest.raises(ValueError, match="nothing to identify"):
        fit_response(np.full((2, 100), 0.3), np.zeros((2, 100)))
