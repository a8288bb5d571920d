"""One request to a webhook: signed as https://www.standardwebhooks.com says, to public addresses only.

The address that was checked is the one that is connected to, so that a name that resolves anew cannot lead
inside the site's network; redirects are not followed and proxies of the environment are not used.
"""

import asyncio
import base64
import hashlib
import hmac
import ipaddress
import secrets
import socket
from typing import Final, NamedTuple

import httpx

from machine.errors import DownrangeError

SECRET_PREFIX: Final = "whsec_"
TIMEOUT_S: Final = 5.0
"""For each step: connecting, and every wait for the receiver."""
DEADLINE_S: Final = 15.0
"""For the whole request."""
_NAT64: Final = ipaddress.ip_network("64:ff9b::/96")
_INSIDE: Final = tuple(
    ipaddress.ip_network(text) for text in ("::/96", "64:ff9b:1::/48", "fec0::/10")
)
"""IPv4-compatible, local translation and site-local addresses: not global, but Python 3.11 says so."""
_PORTS: Final = {"https": 443, "http": 80}

Address = ipaddress.IPv4Address | ipaddress.IPv6Address


class WebhookAddressError(DownrangeError):
    """An address that is not sent to."""

    code = "webhook_address"


class Destination(NamedTuple):
    """Where a request goes."""

    url: httpx.URL
    """With the checked address in place of the name."""
    host: str
    """The name in ASCII, for the Host header and the certificate; an IPv6 address without brackets."""

    def host_header(self) -> str:
        """Value of the header `Host`."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return host if self.url.port is None else f"{host}:{self.url.port}"


def new_secret() -> str:
    """A random key of 256 bits as text."""
    return SECRET_PREFIX + base64.b64encode(secrets.token_bytes(32)).decode()


def signature(secret: str, message_id: str, timestamp_s: int, body: bytes) -> str:
    """Value of the header `webhook-signature`: HMAC-SHA256 over id, time and body."""
    key = base64.b64decode(secret.removeprefix(SECRET_PREFIX))
    content = f"{message_id}.{timestamp_s}.".encode() + body
    return "v1," + base64.b64encode(hmac.new(key, content, hashlib.sha256).digest()).decode()


def destination(text: str, *, may_be_private: bool) -> Destination:
    """Resolve and check an address.

    Args:
        text: URL of a webhook.
        may_be_private: whether addresses inside a network, and http, are allowed.

    Raises:
        WebhookAddressError: no URL, not https, does not resolve, or leads inside a network.
    """
    try:
        url = httpx.URL(text)
    except (httpx.InvalidURL, ValueError) as error:
        raise WebhookAddressError(f"'{text[:200]}' is no address: {error}") from error
    if url.scheme != "https" and not (may_be_private and url.scheme == "http"):
        raise WebhookAddressError("A webhook's address begins with https://.")
    if not url.host or url.userinfo:
        raise WebhookAddressError("A webhook's address has a host and no name or password in it.")
    host = url.raw_host.decode("ascii")
    try:
        port = url.port or _PORTS[url.scheme]
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        raise WebhookAddressError(f"{url.host} cannot be resolved.") from error
    addresses = [ipaddress.ip_address(str(entry[4][0]).partition("%")[0]) for entry in found]
    inside = [address for address in addresses if not is_public(address)]
    if inside and not may_be_private:
        raise WebhookAddressError(
            f"{url.host} is {inside[0]}, inside a network. DOWNRANGE_WEBHOOK_PRIVATE=1 allows that."
        )
    return Destination(url.copy_with(host=str(addresses[0])), host)


def is_public(address: Address) -> bool:
    """Whether an address is one of the public internet, also where another one is wrapped in it."""
    if isinstance(address, ipaddress.IPv6Address):
        wrapped = address.ipv4_mapped or address.sixtofour
        if wrapped is None and address in _NAT64:
            wrapped = ipaddress.IPv4Address(int(address) & 0xFFFF_FFFF)
        if wrapped is not None:
            return is_public(wrapped)
        if address.teredo is not None or any(address in network for network in _INSIDE):
            return False
    return address.is_global and not address.is_multicast


def send(
    to: Destination, secret: str, message_id: str, timestamp_s: int, body: bytes
) -> tuple[bool, str]:
    """Send once; whether the receiver took it (2xx), and what it answered in words."""
    headers = {
        "Host": to.host_header(),
        "Content-Type": "application/json",
        "User-Agent": "Downrange",
        "webhook-id": message_id,
        "webhook-timestamp": str(timestamp_s),
        "webhook-signature": signature(secret, message_id, timestamp_s, body),
    }
    try:
        return asyncio.run(asyncio.wait_for(_post(to, headers, body), DEADLINE_S))
    except TimeoutError:
        return False, f"no answer in {DEADLINE_S:.0f} s"
    except httpx.HTTPError as error:
        return False, type(error).__name__


async def _post(to: Destination, headers: dict[str, str], body: bytes) -> tuple[bool, str]:
    async with (
        httpx.AsyncClient(trust_env=False, follow_redirects=False, timeout=TIMEOUT_S) as client,
        client.stream(
            "POST", to.url, content=body, headers=headers, extensions={"sni_hostname": to.host}
        ) as reply,
    ):
        # The body is left unread: nothing that a receiver says is kept.
        return reply.is_success, f"status {reply.status_code}"
