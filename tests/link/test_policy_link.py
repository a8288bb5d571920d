"""Policy versions over the real link: fetched, switched to, kept over power cuts, taken back."""

import signal

import pytest

from cli.main import main
from machine.conventions import Mode
from machine.messages import ArmRequest, LoadRequest, ThrowState
from machine.policy_approval import (
    SiteTrust,
    approve,
    new_private_key,
    public_key,
    sign_list,
)
from machine.policy_card import file_sha256, load_card, read_policy
from runtime.policies.slots import PolicySlots
from runtime.process.policy_switch import SWITCHING
from runtime.records.log_reader import read_throw_log
from tests.link.yard import MACHINE, Machine, Yard
from tests.runtime.policies.policy_server import policy_server
from tests.runtime.quick_policy import write_policies, write_policy
from tests.waiting import wait_for

KEY = new_private_key()


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """(yard, policy server, folder): the machine asks the policy server, and is bound to no site."""
    yield from make_place(tmp_path_factory.mktemp("policy-yard"))


@pytest.fixture
def other_place(tmp_path):
    yield from make_place(tmp_path)


def make_place(folder):
    installed = write_policies(folder / "installed")
    with policy_server() as server:
        yard = Yard(folder, installed)
        yard.machine = Machine(
            folder / MACHINE, installed, yard.relay.endpoint, **{"server-url": server.url}
        )
        yield yard, server, folder
        yard.close()


def aboard(yard):
    return yard.server.state.policy_sha256["2d"]


def told(yard, kind):
    return [event.data for event in yard.server.events if event.kind == kind]


def version(folder, name, move_rad):
    write_policy(folder / name, Mode.PLANAR, move_rad)
    return folder / name


def test_deploy_refuse_roll_back_and_power_cuts(place, capsys):
    yard, server, folder = place
    data = folder / MACHINE
    yard.ready()
    installed = load_card(folder / "installed" / "quick-2d").policy_sha256
    assert aboard(yard) == installed
    roll_back = ["rollback", "--data", str(data), "--mode", "2d"]
    assert main(roll_back) == 1  # there is no version before

    # Deployed: the transfer breaks off twice.
    server.breaks_after_bytes = [50, 70]
    second = server.want(version(folder, "second-2d", 0.25), 1)
    wait_for(lambda: aboard(yard) == second, 90.0)
    (switched,) = wait_for(lambda: told(yard, "policy_switched"))
    assert (switched["policy_sha256"], switched["deployment_count"]) == (second, 1)

    # A version that is no usable network is refused, and the machine keeps what it has.
    broken = version(folder, "broken-2d", 0.4)
    (broken / "policy.onnx").write_bytes(b"no network")
    card = load_card(folder / "second-2d")
    text = card.model_copy(update={"policy_sha256": file_sha256(broken / "policy.onnx")})
    (broken / "card.json").write_text(text.model_dump_json())
    server.want(broken, 2)
    (refused,) = wait_for(lambda: told(yard, "policy_refused"), 90.0)
    assert refused["deployment_count"] == 2
    assert "policy.onnx" in refused["detail"]
    assert aboard(yard) == second

    # Power cut: it begins with what it had, and does not try the refused one again.
    yard.machine.kill()
    known = len(yard.server.states)
    yard.machine.start()
    wait_for(lambda: len(yard.server.states) > known and aboard(yard) == second, 90.0)
    yard.ready()

    # Taken back at the machine; a second rollback does not bring it again.
    assert main(roll_back) == 0
    wait_for(lambda: aboard(yard) == installed)
    wait_for(lambda: told(yard, "policy_switched")[-1]["policy_sha256"] == installed)
    assert told(yard, "policy_switched")[-1]["deployment_count"] is None
    assert main(roll_back) == 1
    capsys.readouterr()

    # Taken back by the server, which names it; refused after a power cut as well.
    server.want(folder / "second-2d", 3)
    wait_for(lambda: aboard(yard) == second, 90.0)
    third = server.want(version(folder, "third-2d", 0.27), 4, is_rollback=True)
    wait_for(lambda: aboard(yard) == third, 90.0)
    slots = PolicySlots(data / "policies")
    wait_for(lambda: slots.of(Mode.PLANAR).deployment_count == 4)
    yard.machine.kill()
    assert main(roll_back) == 1
    said = capsys.readouterr().err
    assert f"no version before policy {third[:12]}" in said
    assert f"policy {second[:12]} was rolled back" in said
    yard.machine.start()
    yard.ready()

    # Taken back with the machine off.
    server.want(folder / "second-2d", 5)
    wait_for(lambda: aboard(yard) == second, 90.0)
    wait_for(lambda: slots.of(Mode.PLANAR).deployment_count == 5)
    yard.machine.stop()
    server.want(version(folder, "unwanted-2d", 0.26), 6)
    assert main(roll_back) == 0
    known = len(yard.server.states)
    yard.machine.start()
    wait_for(lambda: len(yard.server.states) > known and aboard(yard) == third, 90.0)
    assert told(yard, "booted")[-1]["rolled_back_from"] == {"2d": second}
    # What was asked for before that is refused; what is asked for after it is carried out.
    refused = wait_for(lambda: told(yard, "policy_refused")[1:], 90.0)
    assert [data["deployment_count"] for data in refused] == [6]
    assert "rolled back at the machine" in refused[0]["detail"]
    assert aboard(yard) == third
    meant = server.want(folder / "unwanted-2d", 7)
    wait_for(lambda: aboard(yard) == meant, 90.0)


@pytest.mark.parametrize(
    "victim",
    [
        pytest.param("link", marks=pytest.mark.long),
        "control",
        pytest.param("machine", marks=pytest.mark.long),
    ],
)
def test_killed_while_a_version_comes_it_is_there_in_the_end(place, victim):
    yard, server, folder = place
    yard.ready()
    count = 10 + ["link", "control", "machine"].index(victim)
    asked = len(server.ranges)
    server.breaks_after_bytes = [40]
    wanted = server.want(version(folder, f"for-{victim}", 0.3 + 0.01 * count), count)
    wait_for(lambda: len(server.ranges) > asked)
    if victim == "machine":
        yard.machine.kill()
        yard.machine.start()
    else:
        yard.machine.kill_child(f"runtime.process.{victim}_process", signal.SIGKILL)
    known = len(yard.server.states)
    wait_for(lambda: len(yard.server.states) > known and yard.server.state.policy_sha256.get("2d"))
    wait_for(lambda: aboard(yard) == wanted, 120.0)
    assert yard.server.state.policy_sha256.get("3d")


def test_a_version_that_comes_while_a_plan_is_armed_waits_for_the_end_of_the_throw(place):
    yard, server, folder = place
    yard.ready()
    before = aboard(yard)
    yard.plan = yard.plan.model_copy(update={"policy_sha256": before})
    for number in range(4):
        nonce, throw_id = yard.arm(), yard.new_throw_id()
        wanted = server.want(version(folder, f"late-{number}-2d", 0.35 + number / 100), 20 + number)
        came = folder / MACHINE / "policies" / "versions" / wanted
        # A plan that is not fired ends after 10 s; a busy computer may need longer for the transfer.
        wait_for(lambda came=came: came.is_dir() or yard.server.state.state is ThrowState.DISARMED)
        if yard.server.send(yard.fire_command(nonce, throw_id)).accepted:
            break
        wait_for(lambda wanted=wanted: aboard(yard) == wanted, 90.0)
        before = wanted
        yard.plan = yard.plan.model_copy(update={"policy_sha256": before})
    else:
        raise AssertionError("four plans in a row ended before the version had come")
    yard.server.hold_button(throw_id, yard.epoch)
    wait_for(lambda: "throw_ended" in yard.server.kinds(throw_id))
    yard.server.go_silent()
    wait_for(lambda: aboard(yard) == wanted, 90.0)
    moving = [s for s in yard.server.states if s.throw_id == throw_id]
    assert {s.policy_sha256["2d"] for s in moving if s.state not in SWITCHING} == {before}
    happened = [(e.kind.value, e.throw_id, e.data.get("policy_sha256")) for e in yard.server.events]
    ended = next(n for n, e in enumerate(happened) if e[:2] == ("throw_ended", throw_id))
    switch = next(n for n, e in enumerate(happened) if (e[0], e[2]) == ("policy_switched", wanted))
    assert ended < switch
    yard.wait_for_log(throw_id)
    log = read_throw_log(yard.log_path(throw_id))
    assert log.metadata["plan_hash"] == yard.plan.plan_hash
    # The plan that has just been thrown was made with the version before.
    yard.server.order(LoadRequest, epoch_count=yard.epoch, **yard.server.seen())

    def answer():
        reply = yard.server.order(
            ArmRequest, epoch_count=yard.epoch, plan=yard.plan, **yard.server.seen()
        )
        # A busy computer may let it get too old.
        return None if reply.reason == "command_stale" else reply

    refused = wait_for(answer)
    assert (refused.accepted, refused.reason) == (False, "policy_mismatch")


def trust_of(*folders, serial_count=1):
    approvals = tuple(
        approve(read_policy(f), KEY, approved_by="eve", approved_utc="now") for f in folders
    )
    keys = (public_key(KEY),)
    site = SiteTrust(site="yard", keys=keys, approvals=approvals, serial_count=serial_count - 1)
    return sign_list(site, KEY).model_dump(mode="json")


def test_a_machine_that_is_bound_to_its_site_loads_what_the_site_approves(other_place):
    yard, server, folder = other_place
    installed = folder / "installed" / "quick-2d"
    new = version(folder, "new-2d", 0.27)
    server.trust = trust_of(installed)
    yard.ready()
    # Only one of its two installed versions is approved: the other is taken out, or was not loaded.
    wait_for(lambda: list(yard.server.state.policy_sha256) == ["2d"], 90.0)
    texts = [check.text for check in yard.server.state.checks]
    assert any("3d: none" in text and "not approved by site yard" in text for text in texts)

    def refusals_of_2d():
        return [data["detail"] for data in told(yard, "policy_refused") if data["mode"] == "2d"]

    sha256 = server.want(new, 1)
    (detail,) = wait_for(refusals_of_2d, 90.0)
    assert "new-2d" in detail
    assert "not approved by site yard" in detail
    server.trust = trust_of(installed, new, folder / "installed" / "quick-3d", serial_count=2)
    server.want(new, 2)
    wait_for(lambda: aboard(yard) == sha256 and "3d" in yard.server.state.policy_sha256, 90.0)

    # Bound also over a power cut, with the server gone quiet; an altered card is refused at the start.
    server.trust = None
    yard.machine.kill()
    card = folder / MACHINE / "policies" / "versions" / sha256 / "card.json"
    card.write_text(card.read_text() + " ")
    known = len(yard.server.states)
    yard.machine.start()
    before = load_card(installed).policy_sha256
    wait_for(lambda: len(yard.server.states) > known and aboard(yard) == before, 90.0)
