import base64
import hashlib
import re

import pytest

from server.viewer_proxy import page as page_module
from server.viewer_proxy.page import page_headers, viewer_page
from tests.cases import each


def directives(host: str = "yard.example:8000") -> dict[str, str]:
    policy = page_headers(host)["Content-Security-Policy"]
    return dict(part.strip().split(" ", 1) for part in policy.split(";"))


def test_every_inline_script_of_the_page_is_listed_by_its_hash() -> None:
    page = viewer_page()
    scripts = re.findall(r"<script[^>]*>(.*?)</script>", page.html.decode(), flags=re.DOTALL)
    assert len(scripts) == 2
    for script in scripts:
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in directives()["script-src"]
    # The third is the client's code, which the loader unpacks and writes into the page.
    assert len(page.script_hashes) == 3


def test_our_script_runs_before_the_viewer_starts() -> None:
    html = viewer_page().html.decode()
    assert 0 < html.index("downrange-viewer") < html.index("data-p=")


def test_the_policy_lets_nothing_in_or_out() -> None:
    policy = directives()
    assert policy["default-src"] == "'none'"
    assert policy["frame-ancestors"] == "'self'"
    assert policy["connect-src"] == (
        "'self' ws://yard.example:8000 wss://yard.example:8000 data: blob:"
    )
    assert "'unsafe-inline'" not in policy["script-src"]
    assert "'unsafe-eval'" not in policy["script-src"].replace("'wasm-unsafe-eval'", "")


@each("host", ["", "h; script-src *", "h evil.example", "h\n"])
def test_a_forged_host_adds_nothing_to_the_policy(host: str) -> None:
    assert directives(host)["connect-src"] == "'self' data: blob:"
    assert "script-src *" not in page_headers(host)["Content-Security-Policy"]


def test_the_page_is_never_cached_and_framed_by_us_alone() -> None:
    headers = page_headers("h")
    assert headers["Cache-Control"] == "no-store"
    assert headers["X-Frame-Options"] == "SAMEORIGIN"


def test_another_build_of_viser_is_refused() -> None:
    with pytest.raises(RuntimeError, match="viser"):
        page_module._unpacked_script("<html><script>1</script></html>")


@each("data", [b"", b"\x00", b"\xff\xff", b"abc", b"abcd", bytes(range(256))])
def test_base88_is_undone(data: bytes) -> None:
    alphabet = [c for c in map(chr, range(0x21, 0x7F)) if c not in "\"&<>'`"]
    text = ""
    for start in range(0, len(data), 4):
        group = data[start : start + 4]
        value, digits = int.from_bytes(group, "big"), ""
        for _ in range(len(group) + 1):
            value, digit = divmod(value, 88)
            digits = alphabet[digit] + digits
        text += digits
    assert page_module._decode_base88(text) == data
