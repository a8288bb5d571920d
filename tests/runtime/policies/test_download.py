from collections.abc import Iterator

import pytest

from machine.conventions import Mode
from machine.policy_approval import SiteTrust, new_private_key, public_key
from machine.policy_card import load_card
from runtime.policies.download import TransferError, fetch_version, fetch_wanted
from runtime.policies.slots import PolicySlots
from runtime.records.log_upload import UploadTarget
from tests.cases import each
from tests.runtime.policies.policy_server import PolicyServer, policy_server
from tests.runtime.quick_policy import write_policy


@pytest.fixture
def server() -> Iterator[PolicyServer]:
    with policy_server() as found:
        yield found


@pytest.fixture
def version(tmp_path):
    write_policy(tmp_path / "next-2d", Mode.PLANAR, 0.3)
    return tmp_path / "next-2d"


def fetch(server, slots):
    target = UploadTarget(server.url, "m001", "token")
    trust = SiteTrust(site="yard", keys=(public_key(new_private_key()),), serial_count=7)
    (wanted,) = fetch_wanted(target, trust).policies
    assert server.asked[-1] == f"list=7&key={trust.keys[0].key_id}"
    return fetch_version(target, wanted, slots)


def test_a_transfer_that_breaks_off_goes_on_where_it_was(server, version, tmp_path):
    sha256 = server.want(version, 1)
    size_bytes = (version / "policy.onnx").stat().st_size
    server.breaks_after_bytes = [100, 0, size_bytes - 101]
    slots = PolicySlots(tmp_path / "slots")
    for _ in range(3):
        with pytest.raises(TransferError):
            fetch(server, slots)
        assert not slots.version_folder(sha256).exists()
    folder = fetch(server, slots)
    assert load_card(folder).policy_sha256 == sha256
    assert server.ranges[1:4] == ["bytes=100-", "bytes=100-", f"bytes={size_bytes - 1}-"]
    assert not list(slots.incoming.iterdir())
    # The same again asks for nothing.
    count = len(server.ranges)
    assert fetch(server, slots) == folder
    assert len(server.ranges) == count


def test_a_server_without_ranges_sends_all_again(server, version, tmp_path):
    sha256 = server.want(version, 1)
    server.breaks_after_bytes, server.has_ranges = [100], False
    slots = PolicySlots(tmp_path / "slots")
    with pytest.raises(TransferError):
        fetch(server, slots)
    assert load_card(fetch(server, slots)).policy_sha256 == sha256


def test_other_bytes_than_the_hash_names_are_never_a_version(server, version, tmp_path):
    sha256 = server.want(version, 1)
    slots = PolicySlots(tmp_path / "slots")
    server.spoils = True
    for _ in range(2):
        with pytest.raises(TransferError, match="another hash"):
            fetch(server, slots)
        assert not slots.version_folder(sha256).exists()
    server.spoils = False
    assert load_card(fetch(server, slots)).policy_sha256 == sha256


def test_a_damaged_version_is_fetched_again(server, version, tmp_path):
    server.want(version, 1)
    slots = PolicySlots(tmp_path / "slots")
    folder = fetch(server, slots)
    (folder / "policy.onnx").write_bytes(b"half")
    assert load_card(fetch(server, slots)).policy_id == "next-2d"


@each(
    "change",
    [
        {"policy_sha256": "../../../etc"},
        {"files": [{"name": "../x", "sha256": "a" * 64, "size_bytes": 3}]},
        {"files": [{"name": "policy.onnx", "sha256": "a" * 64, "size_bytes": 10**9}]},
        {"deployment_count": 0},
        {"mode": "4d"},
    ],
)
def test_what_a_server_must_not_ask_for_is_not_done(server, version, change):
    server.want(version, 1)
    server.wanted[0] |= change
    with pytest.raises(TransferError, match="cannot be read"):
        fetch_wanted(UploadTarget(server.url, "m001", "token"))


def test_without_files_or_server_it_is_tried_later(server, version, tmp_path):
    server.want(version, 1)
    server.wanted[0]["files"] = []
    with pytest.raises(TransferError, match="does not have policy"):
        fetch(server, PolicySlots(tmp_path / "slots"))
    with pytest.raises(TransferError, match="cannot be read"):
        fetch_wanted(UploadTarget("http://127.0.0.1:1", "m001", "token"))
