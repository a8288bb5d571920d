"""Every executor gives what one process gives."""

import operator
from functools import partial
from pathlib import Path

import pytest

from evaluation.campaigns import CampaignOptions, open_with, throw_batches, throw_campaign
from evaluation.execution.executor import LocalProcesses, run_tasks
from evaluation.execution.executor_choice import open_executor
from machine.errors import UsageError

TASKS = [partial(operator.truediv, 12, count) for count in (1, 2, 3)]
QUOTIENTS = [12.0, 6.0, 4.0]


def test_tasks_keep_their_order_and_their_errors():
    one, two = LocalProcesses(1), LocalProcesses(2)
    assert run_tasks(TASKS, one, "test") == run_tasks(TASKS, two, "test") == QUOTIENTS
    with pytest.raises(ZeroDivisionError):
        run_tasks([*TASKS, partial(operator.truediv, 1, 0)], two, "test")


def test_no_processes_and_no_scheduler_are_said():
    with pytest.raises(UsageError, match="--jobs 0"), open_executor(0):
        pass
    with (
        pytest.raises(UsageError, match="no Dask scheduler"),
        open_executor(1, "bluetooth://nowhere"),
    ):
        pass


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")  # of the cluster's own start and end
def test_a_scheduler_with_two_workers_gives_the_same(
    swing_policies: Path, monkeypatch: pytest.MonkeyPatch
):
    distributed = pytest.importorskip("distributed")
    options = CampaignOptions("twin", "6", 2, 5, 0, swing_policies, None, None, None)
    tasks = [partial(_thrown, options, seed) for seed in (5, 6)]
    own = run_tasks(tasks, LocalProcesses(1), "test")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, worker_dashboard_address=None
        ) as cluster,
        open_executor(1, cluster.scheduler_address) as executor,
    ):
        assert executor.worker_count == 2
        assert run_tasks(tasks, executor, "test") == own
        with pytest.raises(ZeroDivisionError):
            run_tasks([*TASKS, partial(operator.truediv, 1, 0)], executor, "test")
        # Workers whose code differs would give other numbers.
        monkeypatch.setattr("evaluation.execution.dask_cluster.code_digest", _other_digest)
        with (
            pytest.raises(UsageError, match="runs other code"),
            open_executor(1, cluster.scheduler_address),
        ):
            pass


def _thrown(options: CampaignOptions, seed: int) -> str:
    """As text: a throw that did not land has errors that are no numbers."""
    campaign = open_with(options, "2d", "6")
    return repr(throw_campaign(campaign, 2, seed))


def _other_digest() -> str:
    import os

    return str(os.getpid())


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
