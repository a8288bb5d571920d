"""A real Chromium in front of the real product; every test fails on an error in the browser's console."""

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright

from tests.chromium import CHROMIUM, COARSE_PICTURES, FLAGS
from tests.e2e.browser_console import Console
from tests.e2e.measured_machine import give
from tests.e2e.stack import Demo, ServerAlone, Stack

TIMEOUT_MS = 60_000
"""Everything the tests wait for happens in seconds; a busy computer without graphics takes longer."""


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """In one process tests with processes of their own come last, once the shared demo has ended."""
    for item in items:
        if _is_here(item):
            item.add_marker(pytest.mark.e2e)
            item.add_marker(pytest.mark.timeout(600))
    if not hasattr(config, "workerinput"):
        items.sort(key=lambda item: _is_here(item) and not _uses(item, "demo"))


def _is_here(item: pytest.Item) -> bool:
    return Path(__file__).parent in item.path.parents


def _uses(item: pytest.Item | None, fixture: str) -> bool:
    return fixture in getattr(item, "fixturenames", ())


STARTED = pytest.StashKey[tuple[Demo, tempfile.TemporaryDirectory[str]]]()


def shared_demo(config: pytest.Config) -> Demo:
    """The demo of this process; it is started with the first use, and again after it was stopped."""
    if STARTED not in config.stash:
        folder = tempfile.TemporaryDirectory()
        demo = Demo(Path(folder.name))
        give(demo.machines)
        config.stash[STARTED] = demo, folder
    demo = config.stash[STARTED][0]
    demo.start()
    return demo


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Iterator[None]:
    """The demo ends after the last test that uses it, once the pages of that are closed."""
    try:
        return (yield)
    finally:
        if STARTED in item.config.stash and _uses(item, "demo") and not _uses(nextitem, "demo"):
            item.config.stash[STARTED][0].stop()


def pytest_sessionfinish(session: pytest.Session) -> None:
    if STARTED in session.config.stash:
        demo, folder = session.config.stash[STARTED]
        demo.stop()
        folder.cleanup()


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip("no Chromium found; make test says how to get one")
    expect.set_options(timeout=TIMEOUT_MS)
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield opened
        opened.close()


@pytest.fixture
def demo(pytestconfig: pytest.Config) -> Stack:
    """One demo for all tests of a process; tests leave it disarmed and without a lease."""
    return shared_demo(pytestconfig).ready()


@pytest.fixture
def server(tmp_path: Path) -> Iterator[ServerAlone]:
    alone = ServerAlone(tmp_path)
    yield alone
    alone.kill()


@pytest.fixture
def console() -> Console:
    return Console()


@pytest.fixture
def open_page(browser: Browser, console: Console) -> Iterator[Callable[..., Page]]:
    """Opens pages, each in a profile of its own; small pictures, drawn without graphics hardware."""
    contexts = []

    def open_one(
        stack: Stack, width: int = 1024, height: int = 768, *, touch: bool = False
    ) -> Page:
        context = browser.new_context(
            base_url=stack.url,
            viewport={"width": width, "height": height},
            device_scale_factor=0.5,
            has_touch=touch,
        )
        # For pages that a test opens beside the first, too.
        context.set_default_timeout(TIMEOUT_MS)
        context.add_init_script(COARSE_PICTURES)
        contexts.append(context)
        page = context.new_page()
        page.on("console", console.take)
        page.on("pageerror", lambda error: console.errors.append(str(error)))
        return page

    yield open_one
    for context in contexts:
        context.close()
    assert console.unexpected() == []
