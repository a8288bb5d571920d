import re
import time

import pytest
import zenoh

from machine.channels import machine_key
from machine.messages import CommandReply, EventKind, LoadRequest, ThrowState
from runtime.link.zenoh_config import client_config
from runtime.throw.freshness import COMMAND_AGE_MAX_NS
from server.clock import new_id
from server.machines.machine_link import COMMAND_TIMEOUT_S, MachineLostError, NoAnswerError
from server.store.models import Event
from tests.server.server_bench import wait_for


def load(machine_id="m001"):
    # Above every lease that other tests of the same server have given.
    return LoadRequest(command_id=new_id(), machine_id=machine_id, issuer="t", epoch_count=10**8)


def refusal(running):
    """What the link says of a command now; nothing if it is answered."""
    try:
        running.parts.link.send(load())
    except NoAnswerError as error:
        return str(error)
    return ""


def test_a_command_reaches_the_machine_and_its_answer_us(running, machine):
    command = load()
    reply = running.parts.link.send(command)
    assert (reply.command_id, reply.accepted) == (command.command_id, True), reply.detail
    assert command in machine.commands
    assert 0.0 < running.parts.registry.get("m001").round_trip_s < COMMAND_TIMEOUT_S + 0.5


def test_nothing_is_sent_to_a_machine_that_is_away(running):
    wait_for(lambda: not running.parts.registry.is_connected("m001"))
    with pytest.raises(MachineLostError):
        running.parts.link.send(load())


def test_silence_is_no_answer_and_comes_when_the_command_is_too_old_to_be_executed(
    running, machine
):
    machine.ignores.add("load")
    began_s = time.monotonic()
    with pytest.raises(NoAnswerError, match="0 answers"):
        running.parts.link.send(load())
    assert time.monotonic() - began_s > max(COMMAND_AGE_MAX_NS.values()) * 1e-9
    assert [c.kind for c in machine.commands].count("load") == 1


NONSENSE = (
    b"",
    b"{}",
    b"\xff",
    CommandReply(
        command_id="another",
        machine_id="m001",
        accepted=True,
        state=ThrowState.DISARMED,
        epoch_count=1,
    ).model_dump_json(),
)


def test_an_answer_that_makes_no_sense_is_no_answer(running, machine):
    answers = [NONSENSE[0]]

    def reply(query):
        with query:
            query.reply(query.key_expr, answers[-1])

    machine._declared[0].undeclare()
    queryable = machine.session.declare_queryable(machine._key("command"), reply)
    # Until the router knows of it there is nobody to ask.
    wait_for(lambda: (text := refusal(running)) and "0 answers" not in text)
    for answer in NONSENSE:
        answers.append(answer)
        assert re.search(r"cannot be read|belongs to", refusal(running)), answer
    queryable.undeclare()


def test_two_answers_are_no_answer(running, machine):
    # Someone with the machine's password runs a second one under its name.
    with running.machine() as double:
        double.publishes_state = False
        wait_for(lambda: "two machines use one name" in refusal(running))
        assert double.commands


def test_a_machine_cannot_speak_for_another(running, machine):
    registry = running.parts.registry
    machine.session.put(
        machine_key("yard", "m002", "state"),
        machine.state_message().model_copy(update={"machine_id": "m002"}).model_dump_json(),
    )
    # Nor under its own key with another's name inside.
    machine.session.put(
        machine._key("state"),
        machine.state_message().model_copy(update={"machine_id": "m002"}).model_dump_json(),
    )
    foreign = machine.event(EventKind.FAULT).model_copy(
        update={"machine_id": "m002", "sequence_count": 10**6}
    )
    assert machine.deliver([foreign]) is None
    time.sleep(0.3)
    assert registry.get("m002").state is None
    with running.parts.database.read() as database:
        assert database.query(Event).filter_by(machine_id="m002").count() == 0


def test_wrong_password_does_not_get_in(running):
    endpoint = running.settings.link_listen
    with pytest.raises(zenoh.ZError):
        zenoh.open(client_config(connect=(endpoint,), user="m001", password="wrong"))
    with pytest.raises(zenoh.ZError):
        zenoh.open(client_config(connect=(endpoint,)))


def test_unreadable_messages_are_counted_and_harm_nothing(running, machine):
    counter = running.parts.metrics.unreadable_count
    before = counter._value.get()
    for payload in (b"", b"{}", b"\xff\x00", b'{"machine_id": "m001"}'):
        machine.session.put(machine._key("state"), payload)
        time.sleep(0.05)
        machine.session.put(machine._key("joints"), payload)
        time.sleep(0.05)
    wait_for(lambda: counter._value.get() > before)
    wait_for(lambda: running.parts.registry.is_connected("m001"))


def test_an_unreadable_batch_is_answered_not_swallowed(running, machine):
    key = machine._key("events")
    replies = wait_for(lambda: list(machine.session.get(key, payload=b"nonsense", timeout=20.0)))
    assert replies[0].ok is None


def test_events_come_through_and_are_acknowledged(running, machine):
    wait_for(lambda: not machine._outbox)
    machine.keeps_events = True
    events = [machine.event(EventKind.COMMAND_REFUSED, n=n) for n in range(5)]
    ack = wait_for(lambda: machine.deliver(events))
    assert (ack.boot_id, ack.sequence_count) == (machine.boot_id, events[-1].sequence_count)
    with running.parts.database.read() as database:
        stored = database.query(Event).filter_by(boot_id=machine.boot_id).all()
    assert {e.sequence_count for e in events} <= {e.sequence_count for e in stored}


def test_a_database_that_fails_gives_no_acknowledgement(running, machine, monkeypatch):
    wait_for(lambda: not machine._outbox)
    machine.keeps_events = True
    event = machine.event(EventKind.COMMAND_REFUSED)
    taken, acks = [], []

    def fail(batch):
        taken.append(batch)
        raise OSError("disk full")

    def is_taken() -> bool:
        # Sent again, as a machine does: a router that is opened anew for other accounts loses a batch.
        acks.append(machine.deliver([event]))
        return bool(taken)

    monkeypatch.setattr(running.parts.link, "_take_events", fail)
    wait_for(is_taken)
    assert not any(acks)
    monkeypatch.undo()
    assert wait_for(lambda: machine.deliver([event]))


def test_the_newest_machine_time_is_known_for_the_echo(running, machine):
    registry = running.parts.registry
    first = registry.seen_t_mono_ns("m001")
    wait_for(lambda: registry.seen_t_mono_ns("m001") > first)
    assert time.monotonic_ns() - registry.seen_t_mono_ns("m001") < 15_000_000_000
