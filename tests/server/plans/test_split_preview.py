"""Parts of a preview that end in any order give what one process would have given."""

from concurrent.futures import Future
from dataclasses import replace
from itertools import permutations

import pytest

from server.plans.preview_worker import CancelledPreviewError
from server.plans.split_preview import SplitPreview
from sim_twin.throws.preview import (
    PreviewRequest,
    ThrowPreview,
    nominal_throw,
    preview,
    scatter_parts,
    scattered_throws,
)
from sim_twin.throws.zone_check import ZoneCheck
from tests.cases import each
from tests.sim_twin.throws.test_preview import request


class Split:
    """A preview of a nominal throw and two parts, whose ends are up to the test."""

    def __init__(self, wish: PreviewRequest) -> None:
        self.updates: list[ThrowPreview] = []
        self.cancel_count = 0
        zones = ZoneCheck((), 0.12)
        self.preview = SplitPreview(wish.target, zones, self.updates.append, self._cancel)
        self.nominal: Future[ThrowPreview] = Future()
        self.parts = [Future(), Future()]
        self.preview.follow(self.nominal, self.parts)

    def _cancel(self) -> None:
        self.cancel_count += 1


@pytest.fixture(scope="module")
def wish(swing_policies) -> PreviewRequest:
    return request(swing_policies, rollouts=60)


@pytest.fixture(scope="module")
def whole(wish):
    return preview(wish)


@pytest.fixture(scope="module")
def shown(wish):
    return nominal_throw(wish)


@pytest.fixture(scope="module")
def parts(wish):
    return [scattered_throws(wish, part) for part in scatter_parts(60)]


def facts(found: ThrowPreview):
    return found.impact_m, found.ellipse, found.refused, found.lands_on, found.is_final


@each("order", list(permutations(range(3))))
def test_the_order_in_which_parts_end_does_not_matter(wish, whole, shown, parts, order):
    split = Split(wish)
    ends = [
        lambda: split.nominal.set_result(shown),
        *(lambda i=i: split.parts[i].set_result(parts[i]) for i in range(2)),
    ]
    for index in order:
        assert not split.preview.result.done()
        ends[index]()
    assert facts(split.preview.result.result(0)) == facts(whole)
    # Nothing is told before the throw itself is known, and no ellipse shrinks.
    assert all(update.impact_m == whole.impact_m for update in split.updates)
    counts = [0 if u.ellipse is None else u.ellipse.rollout_count for u in split.updates]
    assert counts == sorted(counts)


def test_a_throw_without_an_impact_needs_no_ellipse(wish, shown, parts):
    split = Split(wish)
    split.parts[0].set_result(parts[0])
    lost = replace(shown, impact_m=None, is_final=True)
    split.nominal.set_result(lost)
    assert split.preview.result.result(0) is lost
    split.parts[1].set_exception(CancelledPreviewError())
    assert (split.cancel_count, split.updates) == (1, [])


def test_a_part_that_fails_ends_the_preview_and_the_other_parts(wish, shown):
    split = Split(wish)
    split.parts[1].set_exception(OSError("gone"))
    split.nominal.set_result(shown)
    with pytest.raises(OSError, match="gone"):
        split.preview.result.result(0)
    assert split.cancel_count == 1


def test_news_that_come_after_the_throw_is_known_are_old(wish, shown):
    split = Split(wish)
    split.preview.show(replace(shown, duration_s=1.0))
    split.nominal.set_result(shown)
    split.preview.show(replace(shown, duration_s=1.0))
    assert [u.duration_s for u in split.updates] == [1.0, shown.duration_s]
