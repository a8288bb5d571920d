"""Uploads: what is refused and why, and that a version is there as a whole or not at all."""

import json
import os
import signal
import subprocess
import sys
import threading
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from cli.main import main
from machine.conventions import Mode
from machine.policy_card import CARD_FILE, GOLDEN_FILE, POLICY_FILE, file_sha256, load_card
from machine.spec import load_spec
from runtime.control.policy_check import check_version
from scripts.golden_vectors import add_golden_vectors
from server.deployments import approval_basis, policy_uploads
from server.deployments.policy_uploads import LIMITS_BYTES
from tests.cases import each
from tests.runtime.quick_policy import write_policy
from tests.server.server_bench import PASSWORD

ROOT = Path(__file__).parents[3]
WHY = {"reason": "retrained"}
UNVALIDATED = WHY | {"is_without_validation": True}
NAMES = (POLICY_FILE, CARD_FILE, GOLDEN_FILE)


@pytest.fixture
def eve(running):
    with running.client("eve") as client:
        yield client


@pytest.fixture(autouse=True)
def quick_checks(monkeypatch):
    """Versions are checked in this process; the child has tests of its own (test_policy_checks.py)."""

    def check(files):
        check_version(files, load_spec())

    for module in (policy_uploads, approval_basis):
        monkeypatch.setattr(module, "check_in_child", check)


@pytest.fixture
def version(request, tmp_path):
    """A version that the session's server has not met."""
    number = zlib.crc32(request.node.nodeid.encode()) % 10**6
    folder = tmp_path / f"up-{number}"
    write_policy(folder, Mode.PLANAR, 0.2 + number / 10**7)
    return folder


def contents(folder):
    return {name: (folder / name).read_bytes() for name in NAMES}


def send(client, files, data=WHY):
    parts = [("files", (name, content)) for name, content in files.items()]
    return client.post("/policies", files=parts, data=data)


def refusal(client, files, status_code=400):
    reply = send(client, files)
    assert reply.status_code == status_code, reply.text
    return reply.json()["error"]["message"]


def uploaded(running):
    folder = running.settings.data_dir / "uploaded-policies"
    return sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []


def test_an_upload_is_a_version_with_its_uploader_and_may_be_deployed(running, eve, version):
    reply = send(eve, contents(version))
    assert reply.status_code == 201, reply.text
    view = reply.json()
    assert (view["policy_id"], view["state"], view["is_present"]) == (
        version.name,
        "uploaded",
        True,
    )
    sha256 = view["policy_sha256"]
    (step,) = eve.get(f"/policies/{sha256}/history").json()
    assert (step["actor"], step["reason"]) == ("eve", "retrained")
    assert eve.post(f"/policies/{sha256}/approve", json=UNVALIDATED).status_code == 201
    body = WHY | {"policy_sha256": sha256}
    assert eve.post("/machines/m001/policies/2d/deploy", json=body).status_code == 201
    again = refusal(eve, contents(version), 409)
    assert again == f"This network is here already as {version.name} (approved)."
    blank = eve.post("/machines/m001/policies/2d/deploy", json=body | {"reason": "    "})
    assert blank.json()["error"]["message"].endswith(
        "it has to be one line with something to read."
    )
    with running.client("root") as root:
        actions = [row["action"] for row in root.get("/audit").json()["rows"]]
    assert "policy.upload" in actions


def truncate(folder):
    (folder / POLICY_FILE).write_bytes((folder / POLICY_FILE).read_bytes()[:-20])


ALTERED = {
    "truncated": (truncate, "no_policy"),
    "altered card": (lambda f: with_card(f, target_range_max_m=12.0), "not_approved"),
    "altered vectors": (
        lambda f: (f / GOLDEN_FILE).write_text((f / GOLDEN_FILE).read_text() + " "),
        "not_approved",
    ),
    "no vectors": (lambda f: (f / GOLDEN_FILE).unlink(), "not_approved"),
}


@pytest.mark.parametrize("case", ALTERED)
def test_what_was_changed_on_the_servers_disk_after_its_approval_is_not_deployed(
    running, eve, version, case
):
    change, code = ALTERED[case]
    sha256 = send(eve, contents(version)).json()["policy_sha256"]
    assert eve.post(f"/policies/{sha256}/approve", json=UNVALIDATED).status_code == 201
    change(running.settings.data_dir / "uploaded-policies" / version.name)
    running.parts.policies.look_again()
    body = WHY | {"policy_sha256": sha256}
    reply = eve.post("/machines/m001/policies/2d/deploy", json=body)
    assert reply.json()["error"]["code"] == code


def at_once(monkeypatch, module, name, *calls):
    """Results of calls on threads of their own, none of which goes on before all are checked."""
    barrier, check = threading.Barrier(len(calls)), getattr(module, name)

    def check_together(*arguments):
        check(*arguments)
        barrier.wait(60.0)

    monkeypatch.setattr(module, name, check_together)
    with ThreadPoolExecutor(len(calls)) as pool:
        return [future.result() for future in [pool.submit(call) for call in calls]]


@pytest.mark.parametrize("is_same_network", [True, False])
def test_of_two_uploads_at_once_one_is_taken(
    running, eve, version, tmp_path, monkeypatch, is_same_network
):
    other = tmp_path / "other" / version.name
    write_policy(other, Mode.PLANAR, 0.444)
    both = contents(version), contents(version if is_same_network else other)
    calls = [lambda files=files: send(eve, files) for files in both]
    replies = at_once(monkeypatch, policy_uploads, "check_in_child", *calls)
    assert sorted(reply.status_code for reply in replies) == [201, 409]
    taken = next(n for n, reply in enumerate(replies) if reply.status_code == 201)
    code = "policy_known" if is_same_network else "policy_name"
    assert replies[1 - taken].json()["error"]["code"] == code
    folder = running.settings.data_dir / "uploaded-policies" / version.name
    assert contents(folder) == both[taken]
    known = [one for one in eve.get("/policies").json() if one["policy_id"] == version.name]
    assert len(known) == 1
    assert len(eve.get(f"/policies/{known[0]['policy_sha256']}/history").json()) == 1


def test_a_name_is_given_once(running, eve, version, tmp_path):
    assert send(eve, contents(version)).status_code == 201
    other = tmp_path / "other" / version.name
    write_policy(other, Mode.PLANAR, 0.333)
    assert "Another version is called" in refusal(eve, contents(other), 409)


def rewritten(folder, change):
    """The version with another network whose card names the right hash."""
    model = onnx.load(str(folder / POLICY_FILE))
    change(model)
    (folder / POLICY_FILE).write_bytes(model.SerializeToString())
    return with_card(folder, policy_sha256=file_sha256(folder / POLICY_FILE))


def with_card(folder, **changes):
    card = json.loads((folder / CARD_FILE).read_text())
    (folder / CARD_FILE).write_text(json.dumps(card | changes))
    return contents(folder)


def tensors(model):
    return {one.name: one for one in model.graph.initializer}


def set_tensor(model, name, value):
    tensors(model)[name].CopyFrom(numpy_helper.from_array(value.astype(np.float32), name))


def external(model):
    tensor = tensors(model)["W"]
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="weights.bin")


def custom_operator(model):
    model.graph.node[-1].domain = "com.example"
    model.opset_import.append(helper.make_opsetid("com.example", 1))


def permuted_inputs(model):
    weights = numpy_helper.to_array(tensors(model)["W"]).copy()
    set_tensor(model, "W", np.roll(weights, 1, axis=0))


def rescaled_outputs(model):
    set_tensor(model, "b", numpy_helper.to_array(tensors(model)["b"]) * 0.9)


def old_operators(model):
    model.opset_import[0].version = 9


def renamed_input(model):
    model.graph.input[0].name = "obs"
    model.graph.node[0].input[0] = "obs"


REFUSED = {
    "truncated": (
        lambda f: contents(f) | {POLICY_FILE: (f / POLICY_FILE).read_bytes()[:-50]},
        "the file was changed or cut off",
    ),
    "empty network": (lambda f: contents(f) | {POLICY_FILE: b""}, "policy.onnx is empty"),
    "empty card": (lambda f: contents(f) | {CARD_FILE: b""}, "card.json is empty"),
    "empty vectors": (lambda f: contents(f) | {GOLDEN_FILE: b""}, "golden_vectors.json is empty"),
    "vectors of other content": (
        lambda f: contents(f) | {GOLDEN_FILE: b"[]"},
        "golden_vectors.json cannot be used: the file: Input should be",
    ),
    "no network": (
        lambda f: (
            (f / POLICY_FILE).write_bytes(b"no network"),
            with_card(f, policy_sha256=file_sha256(f / POLICY_FILE)),
        )[1],
        "is not a usable ONNX file",
    ),
    "external data": (lambda f: rewritten(f, external), "lies outside of the file"),
    "custom operator": (lambda f: rewritten(f, custom_operator), "operator set 'com.example'"),
    "old operators": (lambda f: rewritten(f, old_operators), "operator set 9, taken are 13 to 22"),
    "permuted inputs": (lambda f: rewritten(f, permuted_inputs), "golden observation"),
    "rescaled outputs": (lambda f: rewritten(f, rescaled_outputs), "golden observation"),
    "renamed input": (lambda f: rewritten(f, renamed_input), "expected one float tensor"),
    "wrong hash": (lambda f: with_card(f, policy_sha256="0" * 64), "its card says 000000000000"),
    "other machine": (lambda f: with_card(f, model_sha256="0" * 64), "was trained for model 0000"),
    "other rate": (lambda f: with_card(f, policy_rate_hz=25.0), "policy rate of 25 Hz"),
    "other names": (lambda f: with_card(f, action_names=["a", "b"]), "the card names 2 actions"),
    "no range": (lambda f: with_card(f, target_range_max_m=1.0), "which is no range"),
    "half a card": (
        lambda f: contents(f) | {CARD_FILE: b'{"policy_id": "half-2d"}'},
        "mode: Field required",
    ),
    "a path as name": (lambda f: with_card(f, policy_id="../../etc"), "policy_id: String should"),
    "no vectors": (
        lambda f: {n: c for n, c in contents(f).items() if n != GOLDEN_FILE},
        "golden_vectors.json is missing",
    ),
    "broken vectors": (
        lambda f: contents(f) | {GOLDEN_FILE: b"{}"},
        "golden_vectors.json cannot be used",
    ),
    "another file": (
        lambda f: {"notes.txt": b"", **dict(list(contents(f).items())[:2])},
        "'notes.txt' does not belong",
    ),
    "large card": (
        lambda f: contents(f) | {CARD_FILE: b" " * (LIMITS_BYTES[CARD_FILE] + 1)},
        "card.json has 65537 bytes",
    ),
}


@each("case", REFUSED, copied="version")
def test_what_is_no_usable_version_is_refused_with_the_reason(running, eve, version, case):
    make, words = REFUSED[case]
    before = uploaded(running), len(eve.get("/policies").json())
    assert words in refusal(eve, make(version))
    assert (uploaded(running), len(eve.get("/policies").json())) == before


def test_who_may_not_upload_and_what_is_too_large_is_turned_away_unread(running, eve, version):
    with running.client("sue") as sue:
        assert send(sue, contents(version)).status_code == 403
    assert send(eve, contents(version), {"reason": "x"}).json()["error"]["code"] == "bad_upload"
    large = contents(version) | {POLICY_FILE: b"0" * (sum(LIMITS_BYTES.values()) + 2**17)}
    assert send(eve, large).status_code == 413
    four = [("files", (f"{n}.json", b"{}")) for n in range(4)]
    refused = eve.post("/policies", files=four, data=WHY)
    assert (refused.status_code, refused.json()["error"]["message"]) == (
        400,
        "A version is three files: policy.onnx, card.json and golden_vectors.json.",
    )
    junk = {"Content-Type": "multipart/form-data; boundary=x"}
    assert eve.post("/policies", content=b"--x\r\njunk", headers=junk).status_code == 400


def test_the_command_line_checks_adds_and_shows(running, version, tmp_path, capsys):
    file = tmp_path / "eve.txt"
    file.write_text(PASSWORD, encoding="utf-8")
    login = ("--server", running.url, "--user", "eve", "--password-file", str(file))
    assert main(["policy", "check", str(version)]) == 0
    assert f"{version.name} can be used in 2d" in capsys.readouterr().out
    assert main(["policy", "add", str(version), *WHY_ARGUMENTS, *login]) == 0
    assert f"{version.name}: uploaded" in capsys.readouterr().out
    assert main(["policy", "show", "--policy", version.name, *login]) == 0
    assert "eve: retrained" in capsys.readouterr().out
    retire = ("policy", "retire", "--policy", version.name, *WHY_ARGUMENTS, *login)
    assert main(list(retire)) == 0
    (version / GOLDEN_FILE).unlink()
    assert main(["policy", "check", str(version)]) == 1
    assert "has no golden_vectors.json" in "".join(capsys.readouterr())
    add_golden_vectors(version)
    assert main(["policy", "check", str(version)]) == 0


WHY_ARGUMENTS = ("--reason", "retrained")

UPLOADER = """
import sys
from pathlib import Path
from types import SimpleNamespace

from server.deployments import policy_uploads

source, target = Path(sys.argv[1]), Path(sys.argv[2])
names = ("policy.onnx", "card.json", "golden_vectors.json")
contents = {name: (source / name).read_bytes() for name in names}
nothing = lambda *_: None
policies = SimpleNamespace(views=lambda: [], look_again=nothing, view=nothing)
audit = SimpleNamespace(record=nothing)
uploads = policy_uploads.PolicyUploads(policies, audit, target)
policy_uploads.check_in_child = nothing
real = policy_uploads.os.fsync
steps = [0]

def fsync(descriptor):
    real(descriptor)
    steps[0] += 1
    print(steps[0], flush=True)
    sys.stdin.readline()

policy_uploads.os.fsync = fsync
session = SimpleNamespace(username="eve", actor="eve")
uploads.add(contents, "retrained", session)
print("done", flush=True)
"""


@each("kill_after", range(1, 8), copied="tmp_path")
def test_a_server_that_is_killed_leaves_a_whole_version_or_none(version, tmp_path, kill_after):
    """SIGKILL after each of the writes that reach the disk; the last case is not killed."""
    target = tmp_path / "uploaded"
    process = subprocess.Popen(
        [sys.executable, "-c", UPLOADER, str(version), str(target)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )
    assert process.stdin is not None and process.stdout is not None
    with process:
        for line in process.stdout:
            if line.strip() == "done":
                break
            if int(line) == kill_after:
                os.kill(process.pid, signal.SIGKILL)
                break
            process.stdin.write("\n")
            process.stdin.flush()
    named = [path for path in target.iterdir() if not path.name.startswith(".")]
    # Four files and their folder reach the disk before the rename.
    assert [path.name for path in named] == ([version.name] if kill_after > 5 else [])
    for folder in named:
        assert contents(folder) == contents(version)
        assert load_card(folder).policy_id == version.name


def test_what_a_cut_off_upload_left_is_removed_at_the_next_start(assembled):
    parts = assembled.parts
    left = parts.settings.data_dir / "uploaded-policies" / ".incoming" / "ab12"
    left.mkdir(parents=True)
    (left / POLICY_FILE).write_bytes(b"half")
    (left / CARD_FILE).write_text("{}")
    parts.policies.look_again()
    assert parts.policies.find("0" * 64) is None
    assert not any(view.policy_id == "ab12" for view in parts.policies.views())
    parts.uploads.start()
    assert not left.exists()


def test_a_full_disk_takes_no_version(running, eve, version, monkeypatch):
    before = uploaded(running)
    monkeypatch.setattr(running.parts.uploads, "_min_free_bytes", 2**60)
    assert "The server's disk takes no version: full" in refusal(eve, contents(version), 409)
    assert uploaded(running) == before


def test_open_versions_are_bounded(running, eve, version, monkeypatch):
    monkeypatch.setattr(policy_uploads, "MAX_OPEN_COUNT", 0)
    words = "0 versions are neither approved nor retired; retire some first."
    assert refusal(eve, contents(version), 409) == words
