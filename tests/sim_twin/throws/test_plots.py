from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from machine.errors import UsageError
from sim_twin.throws.plots import TargetScatter, accuracy_figure, ellipse_points, plot_accuracy
from tests.cases import each


def scatter(range_m: float, count: int, seed: int = 0) -> TargetScatter:
    rng = np.random.default_rng(seed)
    return TargetScatter(
        range_m,
        0.1 + 0.2 * rng.standard_normal(count),
        0.05 * rng.standard_normal(count),
        count + 3,
    )


@given(
    seed=st.integers(0, 1000),
    sigma=st.floats(0.1, 3.0),
    shift=st.tuples(st.floats(-5, 5), st.floats(-5, 5)),
)
def test_the_outline_lies_at_its_mahalanobis_distance(
    seed: int, sigma: float, shift: tuple[float, float]
) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.standard_normal((2, 40)) * np.array([[0.5], [0.1]])
    x, y = x + 0.7 * y + shift[0], y - 0.2 * x + shift[1]
    outline = ellipse_points(x, y, sigma) - np.array([x.mean(), y.mean()])
    inverse = np.linalg.inv(np.cov(np.stack([x, y])))
    distance = np.sqrt(np.einsum("ni,ij,nj->n", outline, inverse, outline))
    np.testing.assert_allclose(distance, sigma, rtol=1e-6)


def test_one_landing_has_no_ellipse() -> None:
    with pytest.raises(ValueError, match="two landings, there are 1"):
        ellipse_points(np.zeros(1), np.zeros(1))


def test_figure_names_throws_and_title_and_keeps_axes_equal() -> None:
    figure = accuracy_figure([scatter(7.5, 20), scatter(8.0, 15)], title="seed 4", reach_m=7.5)
    left, right = figure.axes
    assert "seed 4" in figure.get_suptitle()
    assert "35 of 41 throws landed" in figure.get_suptitle()
    assert left.get_aspect() == right.get_aspect() == 1.0
    assert any("n=20" in text.get_text() for text in left.texts)
    labels = right.get_legend_handles_labels()[1]
    assert "7.5 m, n=20" in labels
    assert right.xaxis_inverted(), "left of the target is drawn on the left"


def test_mean_and_sigma_stand_over_the_target() -> None:
    target = TargetScatter(9.0, np.array([-0.1, 0.1, 0.3]), np.zeros(3), 3)
    left = accuracy_figure([target], title="t", reach_m=7.5).axes[0]
    bar = left.containers[0]
    assert bar[0].get_xydata().tolist() == [[9.0, pytest.approx(9.1)]]
    low, high = bar[2][0].get_segments()[0][:, 1]
    assert (high - low) / 2.0 == pytest.approx(0.2)


@each("suffix", [".png", ".svg"])
def test_writes_a_file_even_when_hardly_anything_landed(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"plot{suffix}"
    empty = TargetScatter(9.0, np.zeros(0), np.zeros(0), 5)
    plot_accuracy(path, [scatter(8.0, 1), empty], title="t", reach_m=7.5)
    assert path.stat().st_size > 5000


def test_a_wrong_suffix_or_folder_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"\.png, \.svg, \.pdf"):
        plot_accuracy(tmp_path / "plot.txt", [scatter(8.0, 5)], title="t", reach_m=7.5)
    with pytest.raises(UsageError, match="cannot write the plot"):
        plot_accuracy(tmp_path / "no" / "plot.png", [scatter(8.0, 5)], title="t", reach_m=7.5)
