import json
import shutil

import pytest
from sqlalchemy.exc import DataError

from machine.conventions import Mode
from machine.policy_card import CARD_FILE, POLICY_FILE, load_card
from machine.spec import load_spec
from server.errors import ApiError
from server.plans import policy_store
from server.plans.policy_store import PolicyStore
from tests.cases import each


@pytest.fixture
def folder(tmp_path, swing_policies):
    return shutil.copytree(swing_policies, tmp_path / "policies")


@pytest.fixture
def policies(assembled, folder):
    return PolicyStore(assembled.parts.database, folder, load_spec())


def look_again(policies):
    policies._looked_s = -1e9
    policies.refresh()


def by_id(policies):
    return {view.policy_id: view for view in policies.views()}


def test_active_policies_and_their_reach(policies):
    assert policies.active(Mode.PLANAR).card.policy_id == "swing-2d"
    reach = policies.reach({})
    assert [(item.mode, item.range_min_m, item.range_max_m) for item in reach.modes] == [
        (Mode.PLANAR, 5.5, 10.9),
        (Mode.SPATIAL, 5.5, 10.9),
    ]
    assert len(policies.active_folders()) == 2


def test_the_reach_is_that_of_the_version_on_board(policies, folder):
    """Also while another version is active here; of a version that is not known here nothing is."""
    path = folder / "waits-2d" / CARD_FILE
    path.write_text(json.dumps(json.loads(path.read_text()) | {"target_range_max_m": 8.2}))
    aboard = {"2d": load_card(folder / "waits-2d").policy_sha256}
    look_again(policies)
    assert [item.range_max_m for item in policies.reach(aboard).modes] == [8.2, 10.9]
    assert policies.farthest_m(aboard, [Mode.PLANAR], 0.0) == 8.2
    assert policies.reach({"2d": "0" * 64}) == policies.reach({})


def test_versions_that_are_gone_stay_in_the_history(policies, folder):
    policies.views()
    shutil.rmtree(folder / "waits-2d")
    look_again(policies)
    view = by_id(policies)["waits-2d"]
    assert (view.is_present, view.is_active, view.problem) == (False, False, "its files are gone")
    assert policies.view(view.policy_sha256).card.policy_id == "waits-2d"


def test_a_changed_file_is_never_used(policies, folder):
    policies.views()
    path = folder / "swing-2d" / POLICY_FILE
    path.write_bytes(path.read_bytes() + b"x")
    look_again(policies)
    with pytest.raises(ApiError, match="changed or cut off") as caught:
        policies.active(Mode.PLANAR)
    assert caught.value.code == "policy_unusable"
    assert "sha256" in by_id(policies)["swing-2d"].problem
    assert [item.mode for item in policies.reach({}).modes] == [Mode.SPATIAL]


def test_a_policy_for_another_machine_is_not_used(policies, folder):
    path = folder / "swing-3d" / CARD_FILE
    card = json.loads(path.read_text()) | {"model_sha256": "0" * 64}
    path.write_text(json.dumps(card))
    look_again(policies)
    with pytest.raises(ApiError, match="machine model"):
        policies.active(Mode.SPATIAL)


@each(
    ("text", "words"),
    [
        ("{", "cannot be read"),
        ("[]", "names no policy"),
        ('{"2d": "../../etc"}', "no policy folder"),
        ('{"2d": "swing-3d"}', "not for mode 2d"),
    ],
)
def test_a_malformed_active_file_is_reported(policies, folder, text, words):
    (folder / "active.json").write_text(text)
    look_again(policies)
    with pytest.raises(ApiError, match=words):
        policies.active(Mode.PLANAR)


def test_no_folder_at_all(assembled, tmp_path):
    policies = PolicyStore(assembled.parts.database, tmp_path / "none", load_spec())
    assert not any(view.is_present or view.is_active for view in policies.views())
    with pytest.raises(ApiError):
        policies.active(Mode.PLANAR)


def test_switching_the_active_policy_is_seen(policies, folder):
    assert policies.active(Mode.PLANAR).card.policy_id == "swing-2d"
    (folder / "active.json").write_text('{"2d": "waits-2d", "3d": "swing-3d"}')
    look_again(policies)
    assert policies.active(Mode.PLANAR).card.policy_id == "waits-2d"
    assert policies.name_of(load_card(folder / "waits-2d").policy_sha256) == "waits-2d"
    assert policies.name_of("f" * 64) == "ffffffffffff"


def test_one_version_that_the_database_refuses_does_not_stop_the_others(
    policies, folder, monkeypatch
):
    refused = load_card(folder / "waits-2d").policy_sha256
    real = policy_store.state_of

    def state_of(session, policy_sha256):
        if policy_sha256 == refused:
            raise DataError("insert", {}, ValueError("invalid input syntax for type json"))
        return real(session, policy_sha256)

    monkeypatch.setattr(policy_store, "state_of", state_of)
    policies.refresh()
    assert policies.active(Mode.PLANAR).card.policy_id == "swing-2d"
    assert policies.find(refused) is None
    assert "invalid input syntax" in policies._problems["waits-2d"]


def test_what_failed_is_read_again(policies, monkeypatch):
    def fail(session, policy_sha256):
        raise RuntimeError("no connection")

    with monkeypatch.context() as patched:
        patched.setattr(policy_store, "state_of", fail)
        with pytest.raises(RuntimeError):
            policies.refresh()
    look_again(policies)
    assert policies.active(Mode.PLANAR).card.policy_id == "swing-2d"


def test_an_uploaded_copy_does_not_take_the_place_of_an_installed_version(
    assembled, folder, tmp_path
):
    shutil.copytree(folder / "swing-2d", tmp_path / "uploaded" / "swing-2d")
    store = PolicyStore(assembled.parts.database, folder, load_spec(), tmp_path / "uploaded")
    active = store.active(Mode.PLANAR)
    assert active.folder == folder / "swing-2d"
    assert store.is_installed(active)
