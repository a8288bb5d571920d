"""Answers of the control process on their way to the server."""

import json
from contextlib import ExitStack

from machine.messages import CommandReply, EventKind, ThrowState
from runtime.link.ipc import Kind, Packet
from runtime.process.link_process import LinkProcess
from runtime.process.machine_settings import MachineSettings
from runtime.records.event_intake import ControlEvent
from runtime.records.outbox import EventDraft


def test_an_answer_of_a_latch_that_is_over_keeps_no_other_back(tmp_path, monkeypatch):
    """STOP and its clear in one tick: both events are there before the first answer is looked at."""
    settings = MachineSettings(
        driver="a:B", machine_id="m1", site="yard", data_dir=tmp_path, policies_dir=tmp_path
    )
    answered = []
    with ExitStack() as stack:
        link = LinkProcess(settings, None, None, stack)
        monkeypatch.setattr(link._inbox, "take_reply", lambda number, _: answered.append(number))
        latched = {"latch_id": "b.1", "reason": "STOP by anna"}

        def event(number, kind):
            draft = EventDraft(kind, number, None, None, latched, "2026-01-01T00:00:00+00:00")
            link._intake.take(ControlEvent("b", number, draft))

        def reply(number, state, latch_id=""):
            body = CommandReply(
                command_id=f"c{number}",
                machine_id="m1",
                accepted=True,
                state=state,
                epoch_count=1,
                latch_id=latch_id,
            ).model_dump(mode="json")
            packet = json.dumps({"request": number, "reply": body}).encode()
            link._take(Packet(Kind.REPLY, packet))

        reply(1, ThrowState.STOPPED, "b.1")
        assert answered == []  # Its latch is not on the disk yet.
        event(1, EventKind.STOP_LATCHED)
        event(2, EventKind.STOP_CLEARED)
        reply(2, ThrowState.DISARMED)
        reply(3, ThrowState.ARMED)
    assert answered == [1, 2, 3]
