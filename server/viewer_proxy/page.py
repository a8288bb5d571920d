"""The viewer's page: viser's client with our style and script put in front, and the headers it goes with.

The Content-Security-Policy lists the hashes of the page's scripts, so that nothing else runs there and
nothing connects anywhere but to this origin.
"""

import base64
import hashlib
import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

import viser
import zstandard

_HERE = Path(__file__).parent
_INDEX = Path(viser.__file__).parent / "client" / "build" / "index.html"
_BASE88 = [c for c in (chr(i) for i in range(0x21, 0x7F)) if c not in "\"&<>'`"]


class Page(NamedTuple):
    """The page's bytes and the hashes of its scripts."""

    html: bytes
    script_hashes: tuple[str, ...]


def _sha256(text: str) -> str:
    digest = hashlib.sha256(text.encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"


def _decode_base88(text: str) -> bytes:
    """Undo viser's build step: four bytes in five characters, most significant first."""
    place = {c: i for i, c in enumerate(_BASE88)}
    out = bytearray()
    for start in range(0, len(text), 5):
        group = text[start : start + 5]
        value = 0
        for character in group:
            value = value * 88 + place[character]
        out += value.to_bytes(4, "big")[5 - len(group) :]
    return bytes(out)


def _unpacked_script(index: str) -> str:
    """The client's code as its loader writes it into the page.

    Raises:
        RuntimeError: viser's build does not look like that of the pinned version.
    """
    match = re.search(r'<script data-p="([^"]*)" data-ss="(\d+)" data-cs="(\d+)">', index)
    if match is None:
        raise RuntimeError("viser's client page has an unknown layout; pin viser==1.1.1.")
    packed, style_size, code_size = match.group(1), int(match.group(2)), int(match.group(3))
    plain = zstandard.ZstdDecompressor().decompress(
        _decode_base88(packed), max_output_size=style_size + code_size
    )
    return plain[style_size:].decode()


@cache
def viewer_page() -> Page:
    """Build the page once; reads viser's client from its package."""
    index = _INDEX.read_text(encoding="utf-8")
    style = (_HERE / "page.css").read_text(encoding="utf-8")
    script = (_HERE / "page.js").read_text(encoding="utf-8")
    inline = re.findall(r"<script[^>]*>(.*?)</script>", index, flags=re.DOTALL)
    hashes = (
        _sha256(script),
        *(_sha256(code) for code in inline),
        _sha256(_unpacked_script(index)),
    )
    head = f"<head>\n<script>{script}</script>\n<style>{style}</style>"
    html = index.replace("<head>", head, 1).replace(
        "<title>Viser</title>", "<title>3D view</title>"
    )
    return Page(html.encode(), hashes)


def page_headers(host: str) -> dict[str, str]:
    """Headers of the viewer's page for a request to this host (its Host header, not trusted)."""
    sockets = f" ws://{host} wss://{host}" if re.fullmatch(r"[A-Za-z0-9.:\[\]-]+", host) else ""
    policy = {
        "default-src": "'none'",
        "script-src": " ".join((*viewer_page().script_hashes, "'wasm-unsafe-eval'")),
        "style-src": "'unsafe-inline'",
        "img-src": "'self' data: blob:",
        "font-src": "data:",
        "worker-src": "blob:",
        "connect-src": f"'self'{sockets} data: blob:",
        "frame-ancestors": "'self'",
        "base-uri": "'none'",
        "form-action": "'none'",
    }
    return {
        # A process of its own where the browser can: however long a frame takes to draw, the console
        # around it still sees STOP pressed and the hold button let go.
        "Document-Isolation-Policy": "isolate-and-require-corp",
        "Content-Security-Policy": "; ".join(f"{name} {value}" for name, value in policy.items()),
        "X-Frame-Options": "SAMEORIGIN",
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Cache-Control": "no-store",
    }
