"""Work in several processes gives what one process gives."""

import operator
from functools import partial
from pathlib import Path

import pytest

from evaluation.campaigns import CampaignOptions, open_with, throw_batches, throw_campaign
from evaluation.worker_pool import run_tasks


def test_tasks_keep_their_order_and_their_errors():
    tasks = [partial(operator.truediv, 12, count) for count in (1, 2, 3)]
    assert run_tasks(tasks, 1, "test") == run_tasks(tasks, 2, "test") == [12.0, 6.0, 4.0]
    with pytest.raises(ZeroDivisionError):
        run_tasks([*tasks, partial(operator.truediv, 1, 0)], 2, "test")


def test_batches_throw_what_the_whole_campaign_throws(
    swing_policies: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("evaluation.campaigns.MAX_BATCH_COUNT", 2)
    options = CampaignOptions("twin", "6", 5, 5, 0, swing_policies, None, None, None)
    campaign = open_with(options, "2d", "6")
    whole = throw_campaign(campaign, 5, 5)[0]
    parts = [throw_batches(campaign, 5, 5, range(k, k + 1)) for k in range(3)]
    # Compared as text: a throw that did not land has errors that are no numbers.
    assert repr([result for part in parts for result in part]) == repr(whole)
