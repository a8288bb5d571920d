import json
import shutil

import pytest

from machine.conventions import Mode
from machine.policy_card import CARD_FILE, POLICY_FILE, load_card
from machine.spec import load_spec
from server.errors import ApiError
from server.plans.policies import PolicyShelf


@pytest.fixture
def folder(tmp_path, swing_policies):
    return shutil.copytree(swing_policies, tmp_path / "policies")


@pytest.fixture
def shelf(parts, folder):
    return PolicyShelf(parts.services.database, folder, load_spec())


def look_again(shelf):
    shelf._looked_s = -1e9
    shelf.refresh()


def by_id(shelf):
    return {view.policy_id: view for view in shelf.views()}


def test_active_policies_and_their_reach(shelf):
    assert shelf.active(Mode.PLANAR).card.policy_id == "swing-2d"
    reach = shelf.reach()
    assert [(item.mode, item.range_min_m, item.range_max_m) for item in reach.modes] == [
        (Mode.PLANAR, 5.5, 10.9),
        (Mode.SPATIAL, 5.5, 10.9),
    ]
    assert len(shelf.active_folders()) == 2


def test_versions_that_are_gone_stay_in_the_history(shelf, folder):
    shelf.views()
    shutil.rmtree(folder / "waits-2d")
    look_again(shelf)
    view = by_id(shelf)["waits-2d"]
    assert (view.is_present, view.is_active, view.problem) == (False, False, "its files are gone")
    assert shelf.view(view.policy_sha256).card.policy_id == "waits-2d"


def test_a_changed_file_is_never_used(shelf, folder):
    shelf.views()
    path = folder / "swing-2d" / POLICY_FILE
    path.write_bytes(path.read_bytes() + b"x")
    look_again(shelf)
    with pytest.raises(ApiError, match="changed or cut off") as caught:
        shelf.active(Mode.PLANAR)
    assert caught.value.code == "policy_unusable"
    assert "sha256" in by_id(shelf)["swing-2d"].problem
    assert [item.mode for item in shelf.reach().modes] == [Mode.SPATIAL]


def test_a_policy_for_another_machine_is_not_used(shelf, folder):
    path = folder / "swing-3d" / CARD_FILE
    card = json.loads(path.read_text()) | {"model_sha256": "0" * 64}
    path.write_text(json.dumps(card))
    look_again(shelf)
    with pytest.raises(ApiError, match="machine model"):
        shelf.active(Mode.SPATIAL)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "cannot be read"),
        ("[]", "names no policy"),
        ('{"2d": "../../etc"}', "no policy folder"),
        ('{"2d": "swing-3d"}', "not for mode 2d"),
    ],
)
def test_a_strange_active_file_is_told(shelf, folder, text, words):
    (folder / "active.json").write_text(text)
    look_again(shelf)
    with pytest.raises(ApiError, match=words):
        shelf.active(Mode.PLANAR)


def test_no_folder_at_all(parts, tmp_path):
    shelf = PolicyShelf(parts.services.database, tmp_path / "none", load_spec())
    assert not any(view.is_present or view.is_active for view in shelf.views())
    with pytest.raises(ApiError):
        shelf.active(Mode.PLANAR)


def test_switching_the_active_policy_is_seen(shelf, folder):
    assert shelf.active(Mode.PLANAR).card.policy_id == "swing-2d"
    (folder / "active.json").write_text('{"2d": "waits-2d", "3d": "swing-3d"}')
    look_again(shelf)
    assert shelf.active(Mode.PLANAR).card.policy_id == "waits-2d"
    assert shelf.name_of(load_card(folder / "waits-2d").policy_sha256) == "waits-2d"
    assert shelf.name_of("f" * 64) == "ffffffffffff"
