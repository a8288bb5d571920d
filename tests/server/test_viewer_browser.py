"""The view in a real Chromium, embedded as the console embeds it."""

from collections.abc import Iterator
from typing import Any

import pytest
from playwright.sync_api import Error, Page, sync_playwright

from machine.starts import safe_pose
from server.viewer.state import Reach
from tests.chromium import CHROMIUM, FLAGS
from tests.server.viewer_app import ViewerApp
from tests.waiting import until

SIZE = {"width": 480, "height": 300}

pytestmark = [pytest.mark.e2e, pytest.mark.begins_first, pytest.mark.timeout(180)]


@pytest.fixture
def app() -> Iterator[ViewerApp]:
    opened = ViewerApp()
    opened.scene.update_machine("m001", safe_pose())
    opened.scene.show_machine("s1", "m001")
    opened.scene.set_reach("s1", Reach(7.5, 10.9, 11.4, 5.0))
    yield opened
    opened.close()


@pytest.fixture
def page(app: ViewerApp) -> Iterator[Page]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        context = browser.new_context(viewport=SIZE, has_touch=True)
        context.add_cookies([{"name": "sid", "value": "s1", "url": app.origin}])
        opened = context.new_page()
        opened.goto(app.origin)
        yield opened
        browser.close()


def states(page: Page) -> list[str]:
    found: list[dict[str, Any]] = page.evaluate("states")
    return [state["state"] for state in found if state["source"] == "downrange-viewer"]


def wait_state(page: Page, state: str, count: int = 1) -> None:
    until(
        lambda: page.wait_for_timeout(100) or states(page).count(state) >= count,
        state,
        timeout_s=90.0,
    )


def wait_key(page: Page, code: str) -> None:
    """Without a request for animation frames: software rendering may make those wait for seconds."""
    page.wait_for_function(f"keys.includes('{code}')", polling=100, timeout=90_000)


def yellow_pixels(page: Page) -> int:
    """Pixels of the machine's paint in what the canvas shows."""
    script = """() => {
        const canvas = document.querySelector("#root canvas:not([width='0'])")
            ?? document.querySelector("#root canvas");
        const gl = __viserMutable.canvas.querySelector("canvas") ?? canvas;
        const copy = document.createElement("canvas");
        copy.width = gl.width; copy.height = gl.height;
        const context = copy.getContext("2d");
        context.drawImage(gl, 0, 0);
        const { data } = context.getImageData(0, 0, copy.width, copy.height);
        let count = 0;
        for (let i = 0; i < data.length; i += 4) {
            const [r, g, b, a] = data.slice(i, i + 4);
            if (a > 200 && r > 130 && g > 90 && b < 0.6 * g) count++;
        }
        return count;
    }"""
    try:
        return page.frames[1].evaluate(script)
    except Error:
        return 0


def background(page: Page) -> str:
    return page.frames[1].evaluate("getComputedStyle(document.documentElement).backgroundColor")


def assert_picked(app: ViewerApp, page: Page, count: int) -> None:
    until(lambda: page.wait_for_timeout(50) or len(app.picks) >= count, "the pick")
    session_id, (x, y, z) = app.picks[-1]
    assert session_id == "s1"
    assert 2.0 < x < 14.0
    assert -9.0 < y < 4.0
    assert z == 0.0


def test_the_view_draws_picks_and_reconnects_without_focus(app: ViewerApp, page: Page) -> None:
    wait_state(page, "drawn")
    until(
        lambda: page.wait_for_timeout(200) or yellow_pixels(page) > 300,
        "the machine's paint on the canvas",
        timeout_s=90.0,
    )

    # Nothing of the library's own panel, logo or notes is to be seen.
    chrome = page.frames[1].locator(
        ".mantine-Paper-root, .mantine-Notification-root, .mantine-Image-root"
    )
    assert not any(chrome.nth(i).is_visible() for i in range(chrome.count()))

    # The sky behind the picture follows the scene's theme.
    for theme, sky in (("dark", "rgb(26, 29, 33)"), ("light", "rgb(226, 231, 236)")):
        app.scene.set_theme("s1", theme)
        until(
            lambda sky=sky: page.wait_for_timeout(100) or background(page) == sky,
            f"a {theme} sky",
            timeout_s=90.0,
        )

    # A picture that got another shape is fitted: as much of the machine from left to right as before.
    fovs = [client.camera.fov for client in app.scene.gate.server.get_clients().values()]
    page.set_viewport_size({"width": 300, "height": 480})
    until(
        lambda: (
            page.wait_for_timeout(100)
            or min(c.camera.fov for c in app.scene.gate.server.get_clients().values())
            > fovs[0] + 0.2
        ),
        "a wider lens",
        timeout_s=90.0,
    )
    page.set_viewport_size(SIZE)
    until(
        lambda: (
            page.wait_for_timeout(100)
            or min(c.camera.fov for c in app.scene.gate.server.get_clients().values())
            < fovs[0] + 0.01
        ),
        "the lens of before",
        timeout_s=90.0,
    )

    page.mouse.click(300, 190)
    assert_picked(app, page, 1)
    # A finger picks as well as a mouse.
    page.touchscreen.tap(300, 190)
    assert_picked(app, page, 2)

    # After a click the keys are the console's: STOP must not depend on where the focus is.
    page.wait_for_timeout(200)
    page.keyboard.press("Shift+KeyS")
    wait_key(page, "KeyS")
    page.frames[1].locator("body").focus()
    page.frames[1].evaluate("window.focus()")
    page.keyboard.press("ArrowUp")
    wait_key(page, "ArrowUp")

    # The socket breaks while the focus is in the console: the view comes back by itself.
    page.evaluate("window.focus(); document.body.focus()")
    app.scene.gate.server._websock_server.disconnect_all_clients()
    wait_state(page, "connected", 2)
    until(lambda: page.wait_for_timeout(100) or app.scene.client_count("s1") == 1, "the view again")

    # The session ends: the page says so and gives up.
    app.ended.add("s1")
    app.scene.gate.server._websock_server.disconnect_all_clients()
    wait_state(page, "signed_out")


def test_the_page_cannot_be_led_to_another_server(app: ViewerApp, page: Page) -> None:
    page.goto(f"{app.origin}/viewer/?websocket=ws://evil.example/&playbackPath=//evil.example/x")
    # The library then names our own server there, sooner or later.
    for foreign in ("evil", "playbackPath"):
        assert foreign not in page.evaluate("location.search")
    until(
        lambda: page.wait_for_timeout(100) or app.scene.client_count("s1"),
        "our own server's view",
        timeout_s=60.0,
    )
    refused = page.evaluate(
        """async () => {
            try { await fetch("http://evil.example/"); return "sent"; } catch { return "refused"; }
        }"""
    )
    assert refused == "refused"
