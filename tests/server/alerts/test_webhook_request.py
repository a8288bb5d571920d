import ipaddress
import socket

import pytest

from server.alerts import webhook_request
from server.alerts.webhook_request import (
    WebhookAddressError,
    destination,
    is_public,
    new_secret,
    send,
    signature,
)
from tests.server.alerts.receiver import receiving

SECRET = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"


def test_the_signature_is_that_of_the_standards_example():
    found = signature(SECRET, "msg_p5jXN8AQM9LWM0D4loKWxJek", 1614265330, b'{"test": 2432232314}')
    assert found == "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="


def test_secrets_differ():
    assert len({new_secret() for _ in range(20)}) == 20


@pytest.mark.parametrize(
    "address",
    [
        *("127.0.0.1", "10.1.2.3", "172.16.0.1", "192.168.1.1", "169.254.169.254", "0.0.0.0"),
        *("100.64.0.1", "224.0.0.1", "255.255.255.255", "::1", "fe80::1", "fd00::1", "ff02::1"),
        *("::ffff:10.0.0.1", "64:ff9b::7f00:1", "2002:7f00:1::", "2001:0:7f00:1::1"),
    ],
)
def test_addresses_inside_a_network_are_not_public(address: str):
    assert not is_public(ipaddress.ip_address(address))


@pytest.mark.parametrize("address", ["8.8.8.8", "2606:4700::1111", "::ffff:8.8.8.8"])
def test_addresses_of_the_internet_are_public(address: str):
    assert is_public(ipaddress.ip_address(address))


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("https://127.0.0.1/x", "inside a network"),
        ("https://localhost:8000/x", "inside a network"),
        ("https://[::ffff:169.254.169.254]/", "inside a network"),
        ("http://8.8.8.8/x", "https://"),
        ("ftp://8.8.8.8/x", "https://"),
        ("https://user:word@8.8.8.8/", "no name or password"),
        ("https:///x", "host"),
        ("https://no-such-host.invalid/", "resolved"),
        ("nonsense", "https://"),
    ],
)
def test_what_is_not_sent_to(url: str, said: str):
    with pytest.raises(WebhookAddressError, match=said):
        destination(url, may_be_private=False)


def test_the_address_that_was_checked_is_the_one_that_is_connected_to(monkeypatch):
    def resolve(host: str, port: int, **_: object):
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", ("8.8.8.8", port))]

    monkeypatch.setattr(webhook_request.socket, "getaddrinfo", resolve)
    to = destination("https://hooks.example:8443/a?b=c", may_be_private=False)
    assert str(to.url) == "https://8.8.8.8:8443/a?b=c"
    assert to.host == "hooks.example"


def test_one_address_inside_among_others_is_enough_to_refuse(monkeypatch):
    def resolve(host: str, port: int, **_: object):
        return [(2, 1, 6, "", ("8.8.8.8", port)), (2, 1, 6, "", ("10.0.0.1", port))]

    monkeypatch.setattr(webhook_request.socket, "getaddrinfo", resolve)
    with pytest.raises(WebhookAddressError, match=r"10\.0\.0\.1"):
        destination("https://hooks.example/", may_be_private=False)


def test_a_request_is_signed_and_a_redirect_is_not_followed():
    with receiving() as receiver:
        to = destination(receiver.url, may_be_private=True)
        receiver.answers = [200, 302]
        assert send(to, SECRET, "id-1", 1614265330, b"{}") == (True, "status 200")
        assert send(to, SECRET, "id-2", 1614265330, b"{}") == (False, "status 302")
        ((headers, body), (again, _)) = receiver.got
    assert body == b"{}"
    assert headers["host"] == receiver.url.split("/")[2]
    assert headers["webhook-timestamp"] == "1614265330"
    assert headers["webhook-signature"] == signature(SECRET, "id-1", 1614265330, b"{}")
    assert again["webhook-id"] == "id-2"
    is_delivered, answer = send(to, SECRET, "id-3", 1614265330, b"{}")
    assert (is_delivered, answer) == (False, "ConnectError")
