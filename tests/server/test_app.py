import httpx
import pytest

from server.accounts.accounts import COOKIE
from server.app import create_app
from server.viewer.scene import ViewerScene
from tests.cases import each
from tests.server.server_bench import add_people, make_settings, running_server

PAGE = "<!doctype html><title>Console</title>"


@pytest.fixture(scope="module")
def with_console(tmp_path_factory, swing_policies):
    web = tmp_path_factory.mktemp("web")
    (web / "index.html").write_text(PAGE)
    (web / "assets").mkdir()
    (web / "assets" / "app.js").write_text("1")
    settings = make_settings(tmp_path_factory.mktemp("data"), swing_policies, web_dir=web)
    with running_server(settings) as running:
        add_people(running.parts)
        yield running


@each("path", ["/", "/throws", "/throws/01a1?x=1", "/operate"])
def test_the_console_answers_for_its_own_addresses(with_console, path):
    reply = httpx.get(with_console.url + path, headers={"Accept": "text/html"})
    assert reply.status_code == 200
    assert reply.text == PAGE
    assert "frame-ancestors 'none'" in reply.headers["content-security-policy"]


def test_assets_are_served_and_missing_ones_are_not_the_page(with_console):
    assert httpx.get(f"{with_console.url}/assets/app.js").text == "1"
    assert httpx.get(f"{with_console.url}/assets/none.js").text != PAGE


@each("path", ["/api/v1/nope", "/api/nope", "/api/v2/machines"])
@each("method", ["GET", "POST", "PUT", "DELETE"])
def test_mistyped_addresses_of_the_interface_are_404(with_console, method, path):
    reply = httpx.request(method, with_console.url + path)
    assert reply.status_code == 404
    assert reply.json()["error"]["code"] == "not_found"


def test_the_view_needs_a_session_and_may_be_framed_by_us(with_console):
    address = f"{with_console.url}/viewer/"
    assert httpx.get(address).status_code == 401
    with with_console.client("vic") as client:
        reply = httpx.get(address, cookies={COOKIE: client.cookies[COOKIE]})
    assert reply.status_code == 200
    assert "frame-ancestors 'self'" in reply.headers["content-security-policy"]
    assert reply.headers.get("x-frame-options", "SAMEORIGIN") == "SAMEORIGIN"


def test_health_names_the_parts(with_console):
    body = httpx.get(f"{with_console.url}/api/v1/health").json()
    assert (body["status"], body["database"], body["link"]) == ("ok", "ok", "ok")


def test_a_closed_link_is_degraded(with_console, monkeypatch):
    monkeypatch.setattr(type(with_console.parts.link), "is_open", False)
    reply = httpx.get(f"{with_console.url}/api/v1/health")
    assert reply.status_code == 503
    assert reply.json()["link"] == "closed"


def test_large_answers_are_compressed(with_console):
    with with_console.client("vic") as client:
        reply = client.get("/openapi.json")
    assert reply.headers["content-encoding"] == "gzip"


@pytest.mark.parametrize("view_shadows", [True, False])
def test_the_view_draws_shadows_as_the_settings_say(tmp_path, monkeypatch, view_shadows):
    told = []

    class Scene(ViewerScene):
        def __init__(self, *args, shadows, **kwargs):
            told.append(shadows)
            super().__init__(*args, shadows=shadows, **kwargs)

    monkeypatch.setattr("server.app.ViewerScene", Scene)
    create_app(make_settings(tmp_path, tmp_path, view_shadows=view_shadows))
    assert told == [view_shadows]
