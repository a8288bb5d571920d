"""The report of an evaluation: intervals, failures with logs, sensitivities throw by throw, one page."""

import json
from pathlib import Path

import numpy as np
import pytest

from cli.main import main
from diagnosis.loading.logs import load_throws
from evaluation.accuracy_report.accuracy_drawings import landing_plot, range_plot
from evaluation.measures import target_row
from evaluation.paper import SCATTER
from evaluation.sensitivity import FACTORS
from machine.spec import load_spec
from runtime.records.log_reader import read_throw_log
from sim_twin.confidence_intervals import deviation_interval, mean_interval, proportion_interval
from sim_twin.throws.campaign import ThrowOutcome, ThrowResult

SPEC = load_spec()
pytestmark = pytest.mark.begins_first


def throw(down: float, cross: float, outcome: ThrowOutcome = ThrowOutcome.LANDED) -> ThrowResult:
    return ThrowResult((9.0, 0.0, 0.0), outcome, (0.0,) * 3, down, cross, 3.0, 1.5, 3.0)


def test_intervals_are_those_of_the_textbooks():
    # Student: 1, 2, 3 has mean 2, sd 1, t(0.975, 2) = 4.303.
    low, high = mean_interval(np.array([1.0, 2.0, 3.0]), 0.95)
    assert (low, high) == pytest.approx((2.0 - 4.303 / 3**0.5, 2.0 + 4.303 / 3**0.5), abs=1e-3)
    # Chi-square: n = 10, quantiles 2.700 and 19.023.
    low, high = deviation_interval(2.0, 10, 0.95)
    assert (low, high) == pytest.approx(
        (2.0 * (9 / 19.023) ** 0.5, 2.0 * (9 / 2.700) ** 0.5), abs=1e-3
    )
    # Wilson: 200 of 200 is no certainty; z^2 / (n + z^2).
    low, high = proportion_interval(200, 200, 0.95)
    assert (low, high) == pytest.approx((200 / (200 + 1.96**2), 1.0), abs=1e-3)
    for call in (
        lambda: mean_interval(np.ones(1), 0.9),
        lambda: deviation_interval(1.0, 1, 0.9),
        lambda: proportion_interval(3, 2, 0.9),
    ):
        with pytest.raises(ValueError, match=r"needs two|hits in"):
            call()


def test_a_target_where_nothing_landed_has_no_numbers():
    row = target_row(9.0, [throw(np.nan, np.nan, ThrowOutcome.COLLISION)] * 3)
    assert (row.landed, row.success_ratio.value) == (0, 0.0)
    assert row.success_ratio.ci95[1] > 0.4
    assert row.mean_downrange_error_m.value is row.sd_downrange_m.value is None
    for drawing in (range_plot([row], 7.5, "w"), landing_plot(row, SCATTER["2d"], "w")):
        assert drawing.startswith("<svg")
        assert "nan" not in drawing


def test_the_report_is_one_page_with_data_and_logs_of_what_failed(
    swing_policies: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    def report(policies: Path, out: Path, *more: str) -> int:
        return main(
            ["evaluate", "--mode", "2d", "--policies", str(policies), "--plant", "twin",
             "--throws", "3", "--report", str(out), *more]
        )  # fmt: skip

    good = tmp_path / "good"
    assert report(swing_policies, good, "--targets", "6,9", "--seed", "5", "--jobs", "2") == 0
    html = (good / "report.html").read_text(encoding="utf-8")
    assert html.count("<svg") >= 3
    assert "Seed 5 was given" in html
    assert "prefers-color-scheme: dark" in html
    assert "default-src 'none'" in html
    for outside in ("<script", "http://", "https://", "@import"):
        assert outside not in html
    data = json.loads((good / "report.json").read_text(encoding="utf-8"))["modes"][0]
    assert [t["range_m"] for t in data["targets"]] == [6.0, 9.0]
    assert len(data["sensitivity"]) == len(FACTORS)
    assert data["start_to_release_s"]["value"] > 0.5
    # Throws that end only when their time is over take long; besides the campaign they tell nothing here.
    for name in ("pace_rows", "height_rows", "measure_sensitivity"):
        monkeypatch.setattr(f"evaluation.mode_campaign.{name}", lambda *_: [])
    monkeypatch.setattr("evaluation.mode_campaign.measure_spread_parts", lambda *_: None)
    bad = tmp_path / "bad"
    waits = ("--policy", str(swing_policies / "waits-2d"))
    assert report(swing_policies, bad, "--targets", "6", "--jobs", "1", *waits) == 0
    failed = json.loads((bad / "report.json").read_text(encoding="utf-8"))["modes"][0]["failures"]
    assert [f["outcome"] for f in failed] == ["no_release"] * 3
    for failure in failed:
        log = read_throw_log(bad / failure["log"])
        assert log.is_complete
        assert len(log.control) > 600
        assert failure["log"] in (bad / "report.html").read_text(encoding="utf-8")
    assert load_throws([bad / "logs"]).refused
    assert "0 of 3 landed" in capsys.readouterr().out


def test_options_that_do_not_go_with_a_report_are_refused(tmp_path: Path, capsys):
    out = str(tmp_path)
    assert main(["evaluate", "--mode", "2d", "--jobs", "0"]) == 1
    assert "--jobs 0: at least 1" in capsys.readouterr().err
    assert main(["evaluate", "--mode", "both"]) == 1
    assert "--mode both goes with --report" in capsys.readouterr().err
    assert main(["evaluate", "--mode", "2d", "--report", out, "--plot", "x.png"]) == 1
    assert "leave --json, --plot, --card out" in capsys.readouterr().err
    assert main(["evaluate", "--mode", "both", "--report", out, "--policy", out]) == 1
    assert "--policy names one policy" in capsys.readouterr().err
