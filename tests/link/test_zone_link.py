"""Exclusion zones over the real link: kept over a power cut, and plans of other zones are refused."""

import sqlite3

from machine.messages import ArmRequest, LeaseNotice, LoadRequest, ZonesRequest
from machine.site.zones import ZoneSet
from tests.link.yard import make
from tests.machine.site.test_zones import zone
from tests.waiting import wait_for

# Far from the arm: the set matters to plans only by its name.
OFFICE = ZoneSet(
    version_count=2,
    approved_by="sue",
    zones=(zone(((20.0, 20.0), (24.0, 20.0), (22.0, 25.0))),),
)


def send(yard, zone_set):
    def is_taken():
        reply = yard.server.order(ZonesRequest, zone_set=zone_set, **yard.server.seen())
        return reply is not None and reply.accepted

    wait_for(is_taken)
    wait_for(lambda: yard.server.state.zones_sha256 == zone_set.sha256)


def refusal(yard, plan):
    server = yard.server
    assert server.order(LeaseNotice, epoch_count=yard.epoch).accepted
    wait_for(
        lambda: (
            (reply := server.order(LoadRequest, epoch_count=yard.epoch, **server.seen()))
            and reply.accepted
        )
    )

    def ask():
        command = make(ArmRequest, epoch_count=yard.epoch, plan=plan, **server.seen())
        reply = server.send(command)
        # A busy computer may let it get too old, or the gripper still be empty.
        return reply if reply and reply.reason not in ("command_stale", "no_payload") else None

    return wait_for(ask)


def test_zones_outlive_a_power_cut_and_bind_plans(yard):
    send(yard, OFFICE)
    assert refusal(yard, yard.plan).reason == "zones_mismatch"
    yard.machine.kill()
    known = len(yard.server.states)
    yard.machine.start()
    wait_for(lambda: len(yard.server.states) > known)
    wait_for(lambda: yard.server.state.zones_sha256 == OFFICE.sha256)
    yard.ready()
    refused = refusal(yard, yard.plan)
    assert refused.reason == "zones_mismatch"
    assert OFFICE.sha256[:12] in refused.detail
    # Without zones again, the plan is as good as before.
    send(yard, ZoneSet(version_count=3))
    assert refusal(yard, yard.plan).accepted


def test_zones_that_cannot_be_read_forbid_arming_until_they_are_sent_again(yard):
    send(yard, OFFICE)
    yard.machine.kill()
    with sqlite3.connect(yard.machine.folder / "machine.db") as database:
        database.execute("UPDATE meta SET value='{' WHERE key='zones'")
    database.close()
    known = len(yard.server.states)
    yard.machine.start()
    wait_for(lambda: len(yard.server.states) > known)
    yard.ready()
    state = yard.server.state
    assert state.zones_sha256 is None
    (check,) = (c for c in state.checks if c.check_id == "exclusion_zones")
    assert (check.passed, check.severity) == (False, "error")
    named = yard.plan.model_copy(update={"zones_sha256": OFFICE.sha256})
    assert "cannot be read" in refusal(yard, named).detail
    send(yard, ZoneSet(version_count=3))
    assert refusal(yard, yard.plan).accepted
