"""Every endpoint: signed in, own origin, own header, one error shape, no crash on bad input."""

import json
from contextlib import suppress
from typing import Annotated

import httpx
import pytest
from pydantic import Field, TypeAdapter, ValidationError

from server.accounts.accounts import COOKIE
from server.app import create_app
from server.limits.disk_space import disk_standing
from server.routes import health
from server.schemas.console import Request
from server.settings import Settings
from tests.cases import each
from tests.server.server_bench import METRICS_TOKEN, api_paths, wait_for

OPEN = {
    ("get", "/api/v1/health"),
    ("post", "/api/v1/auth/login"),
    ("post", "/api/v1/enrolments/claim"),
}
CLEAR = {"latch_id": "any", "is_sighted": True, "reason": "nobody is in reach"}
UPLOAD = "/api/v1/machines/{machine_id}/throw-logs/{throw_id}"
OF_MACHINES = (
    UPLOAD,
    "/api/v1/machines/{machine_id}/self-test",
    "/api/v1/machines/{machine_id}/policies/wanted",
    "/api/v1/machines/{machine_id}/policy-files/{policy_sha256}/{name}",
)
"""Asked by a machine with its own token; nobody signs in for it."""


BY_TOKEN = (*OF_MACHINES, "/api/v1/enrolments/claim")
"""No browser sends the token by itself: it does not matter which page asks."""


def operations():
    return [(method, path) for path, methods in api_paths().items() for method in methods]


def concrete(path):
    for name in ("machine_id", "plan_id", "throw_id", "policy_sha256"):
        path = path.replace(f"{{{name}}}", "m001" if name == "machine_id" else "nope")
    return path.removeprefix("/api/v1")


def assert_error(reply, status=None):
    assert reply.headers["content-type"].startswith("application/json"), reply.text
    body = reply.json()
    assert set(body) == {"error"}
    assert set(body["error"]) == {"code", "message", "detail"}
    assert body["error"]["message"]
    if status is not None:
        assert reply.status_code == status, reply.text
    return body["error"]["code"]


def request_models(parent=Request):
    for model in parent.__subclasses__():
        yield model
        yield from request_models(model)


SECRETS_AND_IDS = {
    *("username", "password", "token", "url", "latch_id", "machine_id", "throw_id", "survey_csv"),
    "detail",  # of a machine's self-test
}
"""Compared, looked up or parsed, not shown as they came."""


def test_texts_that_people_write_are_one_line_without_control_characters():
    create_app(Settings(data_dir="/nonexistent"))
    taken = set()
    for model in request_models():
        for name, field in model.model_fields.items():
            kind = TypeAdapter(Annotated[field.annotation, *field.metadata, Field()])
            with suppress(ValidationError):
                kind.validate_python("somebody stood \x07 near the truck")
                taken.add(name)
    assert taken <= SECRETS_AND_IDS


@each(("method", "path"), operations())
def test_every_endpoint_needs_a_session(running, method, path):
    with running.client() as nobody:
        reply = nobody.request(method, concrete(path))
        if (method, path) == ("get", "/api/v1/health"):
            assert reply.status_code == 200
        elif (method, path) == ("get", "/api/v1/auth/me"):
            assert reply.status_code == 200 and reply.json() is None
        elif (method, path) in OPEN:
            assert assert_error(reply, 422) == "invalid"
        else:
            expected = "wrong_token" if path in OF_MACHINES else "not_signed_in"
            assert assert_error(reply, 401) == expected


@each(
    ("method", "path"),
    [(m, p) for m, p in operations() if m != "get" and p not in BY_TOKEN],
)
def test_every_write_needs_our_origin_and_header(running, ada, method, path):
    for headers in (
        {"Origin": "https://evil.example"},
        {"Origin": "null"},
        {"Origin": running.url + ".evil.example"},
    ):
        reply = ada.request(method, concrete(path), headers=headers)
        assert assert_error(reply, 403) == "wrong_origin"
    bare = httpx.Request(
        method,
        f"{running.url}/api/v1{concrete(path)}",
        headers={
            "Origin": running.url,
            "Cookie": f"downrange_session={ada.cookies.get('downrange_session')}",
        },
        json={"username": "ada", "password": "x"} if path.endswith("login") else None,
    )
    assert assert_error(ada.send(bare), 403) == "missing_header"


BODIES = [
    b"",
    b"{",
    b"[]",
    b"null",
    b'"x"',
    b"\xff\xfe",
    b'{"mode": NaN, "target": NaN}',
    b'{"x_m": NaN, "y_m": 1}',
    b'{"x_m": 1e999, "y_m": 1}',
    b'{"x_m": "8", "y_m": [1], "mode": 3}',
    b'{"mode": "2d", "target": {"x_m": 9, "y_m": 0}, "rollout_count": 99999999999999999999}',
    b'{"mode": "2d", "target": {"x_m": 9, "y_m": 0, "range_m": 3}}',
    b'{"surprise": true}',
    b"{" + b'"a":{' * 2000,
    json.dumps({"username": "x" * 10_000, "password": "y"}).encode(),
    json.dumps({"reason": "\x00" * 10}).encode(),
]


@each(
    ("method", "path"),
    [
        (m, p)
        for m, p in operations()
        if m in ("post", "put") and p != UPLOAD and not p.endswith(("logout", "/stop"))
    ],
)
def test_bad_bodies_are_errors_in_the_one_shape(running, method, path):
    with running.client("root") as client:
        for body in BODIES:
            reply = client.request(
                method,
                concrete(path),
                content=body,
                headers={"Content-Type": "application/json"},
            )
            assert reply.status_code < 500 or reply.status_code in (503, 504), reply.text
            if reply.status_code >= 400:
                assert_error(reply)
                assert len(reply.content) < 5000
        client.post("/auth/logout")


def test_a_huge_body_is_refused(running, ada):
    big = b'{"mode": "' + b"x" * 200_000 + b'"}'
    assert assert_error(ada.put("/machines/m001/target", content=big), 413) == "too_large"

    def endless():
        for _ in range(200):
            yield b" " * 1024

    assert assert_error(ada.put("/machines/m001/target", content=endless()), 413) == "too_large"


@each(
    "query",
    [
        {"limit": 0},
        {"limit": 501},
        {"limit": "many"},
        {"mode": "4d"},
        {"outcome": "great"},
        {"min_range_m": "nan"},
        {"max_range_m": "inf"},
        {"since": "yesterday"},
        {"machine_id": "x" * 100},
        {"cursor": "y" * 100},
    ],
)
def test_bad_filters_are_refused(ada, query):
    for path in ("/throws", "/throws/stats", "/throws/export.csv"):
        if path != "/throws" and {"limit", "cursor"} & set(query):
            continue
        assert assert_error(ada.get(path, params=query), 422) == "invalid"


@each("cursor", ["zzz", "' OR 1=1 --", "0", "\x00"])
def test_strange_cursors_give_a_page_or_an_error(ada, cursor):
    assert ada.get("/throws", params={"cursor": cursor}).status_code in (200, 422, 503)


@each("path", ["/nope", "/machines/m001/nope", "/../api/v1/x"])
def test_unknown_addresses_are_json_404(ada, path):
    assert assert_error(ada.get(path), 404) == "not_found"


def test_unknown_things_are_404_with_their_own_code(running, ada):
    for path, code in (
        ("/machines/zz", "no_machine"),
        ("/plans/zz", "no_plan"),
        ("/plans/zz/frames", "no_plan"),
        ("/throws/zz", "no_throw"),
        ("/throws/zz/series", "no_log"),
        ("/throws/zz/log", "no_log"),
        ("/policies/zz", "no_policy"),
    ):
        assert assert_error(ada.get(path), 404) == code
    assert assert_error(ada.post("/throws/zz/replay", json={"at_s": 0}), 404) == "no_throw"
    mark = {"downrange_error_m": 0, "crossrange_error_m": 0}
    assert assert_error(ada.post("/throws/zz/impacts", json=mark), 404) == "no_throw"
    with running.client("root") as root:
        assert assert_error(root.post("/machines/zz/stop"), 404) == "no_machine"
        assert assert_error(root.post("/machines/zz/stop/clear", json=CLEAR), 404) == "no_machine"


def test_wrong_method_is_named(ada):
    reply = ada.put("/machines/m001")
    assert assert_error(reply, 404) == "not_found"
    assert "PUT" in reply.json()["error"]["message"]


def test_security_headers_everywhere(running, ada):
    for reply in (ada.get("/health"), ada.get("/nope"), httpx.get(f"{running.url}/nothing")):
        assert reply.headers["x-content-type-options"] == "nosniff"
        assert "default-src 'self'" in reply.headers["content-security-policy"]
        assert reply.headers["x-frame-options"] == "DENY"
        assert "server" not in reply.headers
    assert ada.get("/health").headers["cache-control"] == "no-store"


def test_cookie_is_http_only_and_strict(running):
    with running.client() as client:
        reply = client.post(
            "/auth/login", json={"username": "vic", "password": "correct horse battery"}
        )
    cookie = reply.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie


def test_roles_decide_and_denials_are_recorded(running):
    with running.client("vic") as viewer, running.client("root") as root:
        assert viewer.get("/machines").status_code == 200
        for method, path, body in (
            ("post", "/machines/m001/lease", None),
            ("post", "/machines/m001/load", None),
            ("post", "/machines/m001/stop/clear", CLEAR),
            ("post", "/machines/m001/lease/take", {"reason": "because"}),
            ("post", "/machines", {"machine_id": "m050"}),
            ("get", "/audit", None),
        ):
            assert assert_error(viewer.request(method, path, json=body), 403) == "not_allowed"
        rows = root.get("/audit", params={"actor": "vic", "limit": 20}).json()["rows"]
        denied = {row["action"] for row in rows if row["phase"] == "denied"}
        assert {"lease", "throw", "stop.clear", "lease.take", "machine.enrol"} <= denied


def test_brake_answers_429_with_the_time(running):
    with running.client() as client:
        for _ in range(5):
            reply = client.post("/auth/login", json={"username": "mallory", "password": "x"})
            assert assert_error(reply, 401) == "login_failed"
        reply = client.post("/auth/login", json={"username": "mallory", "password": "x"})
        assert assert_error(reply, 429) == "too_many_logins"
        assert int(reply.headers["retry-after"]) > 200


def test_audit_pages_and_verifies(running):
    with running.client("root") as root:
        first = root.get("/audit", params={"limit": 3}).json()
        assert len(first["rows"]) == 3
        second = root.get("/audit", params={"limit": 3, "cursor": first["next_cursor"]}).json()
        numbers = [row["sequence_count"] for row in first["rows"] + second["rows"]]
        assert numbers == list(range(numbers[0], numbers[0] - 6, -1))
        assert assert_error(root.get("/audit", params={"cursor": "x"}), 400) == "bad_cursor"
        assert root.get("/audit/verify").json()["is_intact"]


def test_enrolled_machines_are_listed_before_they_are_seen(running):
    with running.client("root") as root:
        body = {"machine_id": "m002", "name": "North pile"}
        assert root.post("/machines", json=body).json()["machine"]["lamp"] == "never_seen"
        names = {m["machine_id"]: m["name"] for m in root.get("/machines").json()}
        assert names["m002"] == "North pile"
        new = root.post("/machines", json={"machine_id": "loader-7"})
        assert new.status_code == 201
        path = running.parts.registry.secret_path("loader-7")
        assert path.stat().st_mode & 0o777 == 0o600
        for bad in ("UPPER", "a/b", "x" * 40, "-a"):
            assert assert_error(root.post("/machines", json={"machine_id": bad}), 422)


def test_targets_belong_to_a_session(running, ada):
    put = ada.put("/machines/m001/target", json={"range_m": 5.0, "azimuth_rad": 1.0, "z_m": 0.5})
    assert put.status_code == 200
    assert put.json()["range_m"] == pytest.approx(5.0)
    assert ada.get("/machines/m001").json()["target"]["azimuth_rad"] == pytest.approx(1.0)
    with running.client("bob") as bob:
        assert bob.get("/machines/m001").json()["target"] is None
    assert ada.delete("/machines/m001/target").status_code == 204
    assert ada.get("/machines/m001").json()["target"] is None


def test_view_settings_reach_the_scene(running, ada):
    body = {"machine_id": "m001", "mode": "2d", "theme": "dark", "camera": "top"}
    assert ada.put("/view", json=body).status_code == 204
    session_id = ada.get("/auth/me").json()["session_id"]
    scene, seen = running.parts.scene, []
    # Jobs of the drawing thread run in order: by the time this one runs the others have.
    scene._stage.apply(session_id, seen.append, None)
    state = wait_for(lambda: seen)[0]
    assert (state.machine_id, state.theme, state.camera) == ("m001", "dark", "top")
    assert state.reach.planar_m == pytest.approx(10.9)
    assert assert_error(ada.put("/view", json={"machine_id": "zz"}), 404) == "no_machine"


def test_a_pick_in_the_view_becomes_the_target(running, ada):
    ada.put("/view", json={"machine_id": "m001"})
    session_id = ada.get("/auth/me").json()["session_id"]
    running.parts.targets.take_pick(session_id, (8.0, 1.0, 0.0))
    assert ada.get("/machines/m001").json()["target"]["y_m"] == 1.0


def test_policies_are_listed_with_their_cards(ada):
    policies = ada.get("/policies").json()
    assert {p["policy_id"] for p in policies if p["is_active"]} == {"swing-2d", "swing-3d"}
    one = ada.get(f"/policies/{policies[0]['policy_sha256']}").json()
    assert one["is_active"]
    assert one["is_present"]
    assert one["problem"] is None
    assert one["card"]["policy_sha256"] == one["policy_sha256"]


def test_metrics_are_for_the_token_and_for_auditors(running, ada):
    address = f"{running.url}/metrics"
    token = {"Authorization": f"Bearer {METRICS_TOKEN}"}
    text = httpx.get(address, headers=token).text
    assert "downrange_http_request_seconds" in text
    assert httpx.get(address).status_code == 401
    for wrong in ("Bearer guess", "Bearer", "Basic x"):
        assert httpx.get(address, headers={"Authorization": wrong}).status_code == 401
    for name, status_code in (("ada", 403), ("sue", 200)):
        with running.client(name) as client:
            cookies = {COOKIE: client.cookies[COOKIE]}
            assert httpx.get(address, cookies=cookies).status_code == status_code


def test_a_full_disk_shows_in_health(running, ada, monkeypatch):
    assert ada.get("/health").json()["disk"] == "ok"
    monkeypatch.setattr(health, "disk_standing", lambda *_: "full: 3 MB free, 268 MB needed")
    reply = ada.get("/health")
    assert (reply.status_code, reply.json()["status"]) == (503, "degraded")
    monkeypatch.undo()
    assert disk_standing(running.settings.data_dir, 2**62).startswith("full: ")
    assert disk_standing(running.settings.data_dir / "none", 1).startswith("cannot be read")


def test_a_forwarded_address_of_a_caller_that_is_no_proxy_does_not_count(running):
    with running.client() as client:
        body = {"username": "nobody-here", "password": "guess"}
        codes = [
            client.post(
                "/auth/login", json=body, headers={"X-Forwarded-For": f"10.9.8.{index}"}
            ).status_code
            for index in range(8)
        ]
    assert codes == [401] * 5 + [429] * 3


def test_openapi_is_served_and_has_stable_names(running, ada):
    assert httpx.get(f"{running.url}/api/v1/openapi.json").status_code == 401
    document = ada.get("/openapi.json").json()
    ids = [op["operationId"] for ops in document["paths"].values() for op in ops.values()]
    assert len(ids) == len(set(ids))
    assert {"fire_plan", "arm_plan", "list_throws", "stream_events"} <= set(ids)
