import threading
from datetime import timedelta

import pytest

from machine.messages import MachineState, ThrowState
from machine.starts import safe_pose
from server.clock import utc_now
from server.errors import ApiError, NotFoundError
from server.machines.lease_service import LeaseService
from server.schemas.console import Role
from server.store.models import Audit


class Now:
    """A clock that tests move."""

    def __init__(self):
        self.value = utc_now()

    def __call__(self):
        return self.value

    def later(self, seconds):
        self.value += timedelta(seconds=seconds)


@pytest.fixture
def now():
    return Now()


@pytest.fixture
def book(assembled, now):
    return make_book(assembled, now)


def make_book(assembled, now, ttl_s=15.0):
    parts = assembled.parts
    return LeaseService(
        parts.database,
        parts.audit,
        parts.registry,
        parts.hub,
        ttl_s=ttl_s,
        idle_s=600.0,
        now=now,
    )


def state_with_epoch(epoch):
    return MachineState(
        machine_id="m001",
        boot_id="b",
        t_mono_ns=1,
        state=ThrowState.DISARMED,
        epoch_count=epoch,
        joint_position_rad_m=tuple(safe_pose()),
        payload_held=True,
        stop_latched=False,
        model_sha256="0" * 64,
    )


def test_acquire_renew_release(assembled, book, now):
    ada = assembled.session("ada")
    first = book.acquire("m001", ada)
    assert (first.epoch_count, first.holder, first.holder_session_id) == (1, "ada", ada.session_id)
    now.later(10.0)
    renewed = book.acquire("m001", ada)
    assert renewed.epoch_count == 1
    assert renewed.expires_utc > first.expires_utc
    freed = book.release("m001", ada)
    assert (freed.holder, freed.epoch_count) == (None, 2)
    assert book.release("m001", ada).epoch_count == 2


def test_held_lease_is_refused_with_the_holder(assembled, book):
    book.acquire("m001", assembled.session("ada"))
    bob = assembled.session("bob")
    with pytest.raises(ApiError, match="with ada") as caught:
        book.acquire("m001", bob)
    assert caught.value.code == "lease_held"
    with pytest.raises(ApiError) as caught:
        book.require("m001", bob)
    assert caught.value.code == "no_lease"
    book.release("m001", bob)
    assert book.view("m001").holder == "ada"


def test_same_person_in_two_browsers_is_two_holders(assembled, book):
    book.acquire("m001", assembled.session("ada"))
    with pytest.raises(ApiError):
        book.acquire("m001", assembled.session("ada"))


def test_lease_runs_out_without_renewal(assembled, book, now):
    ada, bob = assembled.session("ada"), assembled.session("bob")
    epochs = []
    book.on_new_epoch.append(lambda machine_id, epoch: epochs.append((machine_id, epoch)))
    book.acquire("m001", ada)
    now.later(15.1)
    with pytest.raises(ApiError):
        book.require("m001", ada)
    assert book.view("m001").holder is None
    book.expire_due()
    assert epochs == [("m001", 1), ("m001", 2)]
    assert book.acquire("m001", bob).epoch_count == 3


def test_idle_lease_is_given_back_although_renewed(assembled, now):
    book = make_book(assembled, now, ttl_s=200.0)
    ada = assembled.session("ada")
    book.acquire("m001", ada)
    for _ in range(4):
        now.later(151.0)
        book.acquire("m001", ada)
        book.expire_due()
    assert (book.view("m001").holder, book.view("m001").epoch_count) == (None, 2)


def test_a_used_lease_is_kept(assembled, now):
    book = make_book(assembled, now, ttl_s=200.0)
    ada = assembled.session("ada")
    book.acquire("m001", ada)
    for _ in range(5):
        now.later(151.0)
        book.acquire("m001", ada)
        book.require("m001", ada)
        book.expire_due()
    assert (book.view("m001").holder, book.view("m001").epoch_count) == ("ada", 1)


def test_take_over_counts_up_and_is_recorded(assembled, book):
    ada, sue = assembled.session("ada"), assembled.session("sue", Role.SUPERVISOR)
    book.acquire("m001", ada)
    taken = book.take("m001", sue, "shift change")
    assert (taken.holder, taken.epoch_count) == ("sue", 2)
    with pytest.raises(ApiError):
        book.require("m001", ada)
    with assembled.parts.database.read() as database:
        row = database.query(Audit).filter_by(action="lease.take").one()
    assert "shift change" in row.detail_json
    assert '"from":"ada"' in row.detail_json


def test_two_operators_racing_get_one_lease(assembled, book):
    people = [assembled.session(f"p{index}") for index in range(8)]
    barrier = threading.Barrier(len(people))
    won, refused, other = [], [], []

    def race(person):
        barrier.wait()
        try:
            won.append(book.acquire("m001", person))
        except ApiError as error:
            refused.append(error.code)
        except BaseException as error:
            other.append(error)

    threads = [threading.Thread(target=race, args=(person,)) for person in people]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not other
    assert len(won) == 1
    assert refused == ["lease_held"] * 7
    assert book.view("m001").epoch_count == 1


def test_epoch_starts_above_what_the_machine_remembers(assembled, book):
    assembled.parts.registry.take_state(state_with_epoch(41))
    assert book.acquire("m001", assembled.session()).epoch_count == 42


def test_epochs_never_fall(assembled, book, now):
    seen = [0]
    for index in range(20):
        session = assembled.session(f"p{index}")
        seen.append(book.acquire("m001", session).epoch_count)
        if index % 3:
            seen.append(book.release("m001", session).epoch_count)
        else:
            now.later(20.0)
            book.expire_due()
            seen.append(book.view("m001").epoch_count)
    assert seen == sorted(set(seen))


def test_restart_frees_everything_with_new_epochs(assembled, book):
    book.acquire("m001", assembled.session())
    book.free_all()
    assert (book.view("m001").holder, book.view("m001").epoch_count) == (None, 2)
    assert book.view("m002").epoch_count == 0


def test_session_end_gives_back(assembled, book):
    ada = assembled.session()
    book.acquire("m001", ada)
    book.acquire("m002", ada)
    book.end_session(ada)
    assert [book.view(m).holder for m in ("m001", "m002")] == [None, None]


def test_unknown_machine(assembled, book):
    with pytest.raises(NotFoundError):
        book.acquire("nobody", assembled.session())
