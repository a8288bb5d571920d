"""What an operator does in the console, in words."""

import contextlib
import re

from playwright.sync_api import Locator, Page
from playwright.sync_api import TimeoutError as BrowserTimeoutError

from tests.e2e.stack import Stack

HOLD = '[data-testid="hold"]'
STARVED = ("heartbeat", "did not confirm")
"""Words for a hold signal that came too late, and for a command that was not answered in time. A busy
computer may starve either, and the machine then aborts or stays still, as it must."""


def sign_in(page: Page, stack: Stack, username: str = "operator", path: str = "/operate") -> None:
    page.goto(path)
    page.get_by_label("Name").fill(username)
    page.locator("input[type=password]").fill(stack.passwords[username])
    page.get_by_role("button", name="Sign in").click()
    page.get_by_test_id("stop").wait_for()


def without_view(page: Page) -> None:
    """The console must work without the 3D view; and a computer without graphics is quicker so."""
    body = "<!doctype html><title>no view</title>"
    page.route("**/viewer/**", lambda route: route.fulfill(body=body, content_type="text/html"))


def take_control(page: Page) -> None:
    page.get_by_test_id("gate").get_by_role("button", name="Take control").click()
    page.get_by_test_id("lease-words").filter(has_text="You are in control").wait_for()


def gate(page: Page, gate_id: str) -> Locator:
    return page.locator(f'[data-testid="gate"][data-gate="{gate_id}"]')


def lamp(page: Page, phase: str) -> Locator:
    return page.locator(f'header [data-testid="lamp"][data-phase="{phase}"]')


def load_if_empty(page: Page) -> None:
    """Load when the console asks for it; otherwise the button is there already."""
    ready = page.locator(f'{HOLD}:not([aria-disabled="true"])')
    empty = gate(page, "no_payload")
    _wait_for(page, ready.or_(empty).first, "nothing to hold")
    if empty.count():
        empty.get_by_role("button", name="Load").click()
    ready.wait_for()


def open_step(page: Page, title: str) -> None:
    heading = page.get_by_role("complementary").get_by_role("button", name=re.compile(title))
    if heading.get_attribute("aria-expanded") != "true":
        heading.click()


def result_text(page: Page) -> str:
    page.get_by_test_id("result").wait_for()
    return page.get_by_test_id("result").inner_text()


def throw_until_landed(page: Page, press: str, attempts: int = 4) -> None:
    """Hold until the load has landed, by pointer or by key; again if this computer starved the signal."""
    text = "nothing"
    for _ in range(attempts):
        load_if_empty(page)
        button = page.locator(HOLD)
        _press(page, button, press)
        if not _is_taken(page):
            # A preview that is made anew turns the button off: a person sees it, lets go, presses again.
            _let_go(page, press)
            continue
        text = outcome(page, while_held=True)
        _let_go(page, press)
        if not any(words in text for words in STARVED):
            return
        again = page.get_by_role("button", name="Throw again")
        if again.count():
            again.click()
    raise AssertionError(f"{attempts} throws and none landed; the last said: {text}")


def _press(page: Page, button: Locator, press: str) -> None:
    if press == "key":
        button.focus()
        page.keyboard.down("Space")
        return
    box = button.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()


def _is_taken(page: Page) -> bool:
    """Whether the button answers the press: with its ring, or with why not."""
    answers = page.locator(f'{HOLD}:not([data-phase="idle"]), {HOLD}[data-note]')
    try:
        answers.or_(page.get_by_test_id("result")).first.wait_for(timeout=5_000.0)
    except BrowserTimeoutError:
        return False
    return True


def _let_go(page: Page, press: str) -> None:
    if press == "key":
        page.keyboard.up("Space")
    else:
        page.mouse.up()


def outcome(page: Page, *, while_held: bool = False) -> str:
    """The result, or why there was no throw at all.

    While the button is still down it tells the reason itself.
    """
    note = page.locator(f"{HOLD}[data-note]") if while_held else page.get_by_test_id("hold-note")
    _wait_for(page, page.get_by_test_id("result").or_(note).first, "no result")
    return page.get_by_role("complementary").inner_text()


def _wait_for(page: Page, awaited: Locator, otherwise: str) -> None:
    try:
        awaited.wait_for()
    except BrowserTimeoutError as error:
        words = page.get_by_role("complementary").inner_text()
        raise AssertionError(f"{otherwise}; the panel says:\n{words}") from error


def click_until(page: Page, share: tuple[float, float], shown: Locator) -> tuple[float, float]:
    """Click the 3D view until the page shows that it has the point; returns the pixel.

    On a computer without graphics the picture may hang for seconds; a person clicks again.
    """
    page.locator('[data-testid="viewer"][data-state="drawn"]').wait_for()
    box = page.get_by_test_id("viewer").bounding_box()
    assert box is not None
    at = box["x"] + share[0] * box["width"], box["y"] + share[1] * box["height"]
    for _ in range(4):
        page.mouse.click(*at)
        with contextlib.suppress(BrowserTimeoutError):
            shown.wait_for(timeout=15_000.0)
            return at
    raise AssertionError(f"four clicks on the 3D view and no answer; waited for {shown}")


def metres_of(text: str) -> float:
    """`-0.08 m short` to -0.08."""
    found = re.match(r"([+\u2212]?)(\d+\.\d+) m", text)
    assert found, text
    return float(found.group(2)) * (-1.0 if found.group(1) == "\u2212" else 1.0)
