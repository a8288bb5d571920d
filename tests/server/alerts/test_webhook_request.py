import ipaddress
import socket
import threading
import time

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
from tests.cases import each
from tests.server.alerts.receiver import receiving

SECRET = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"


def test_the_signature_is_that_of_the_standards_example():
    found = signature(SECRET, "msg_p5jXN8AQM9LWM0D4loKWxJek", 1614265330, b'{"test": 2432232314}')
    assert found == "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="


def test_secrets_differ():
    assert len({new_secret() for _ in range(20)}) == 20


@each(
    "address",
    [
        *("127.0.0.1", "10.1.2.3", "172.16.0.1", "192.168.1.1", "169.254.169.254", "0.0.0.0"),
        *("100.64.0.1", "224.0.0.1", "255.255.255.255", "::1", "fe80::1", "fd00::1", "ff02::1"),
        *("::ffff:10.0.0.1", "64:ff9b::7f00:1", "2002:7f00:1::", "2001:0:7f00:1::1"),
        *("::7f00:1", "::808:808", "64:ff9b:1::808:808", "fec0::1"),
    ],
)
def test_addresses_inside_a_network_are_not_public(address: str):
    assert not is_public(ipaddress.ip_address(address))


@each("address", ["8.8.8.8", "2606:4700::1111", "::ffff:8.8.8.8"])
def test_addresses_of_the_internet_are_public(address: str):
    assert is_public(ipaddress.ip_address(address))


@each(
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


def test_a_name_with_other_letters_goes_out_in_ascii(monkeypatch):
    asked: list[str] = []

    def resolve(host: str, port: int, **_: object):
        asked.append(host)
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", ("127.0.0.1", port))]

    with receiving() as receiver:
        port = receiver.url.split("/")[2].partition(":")[2]
        with monkeypatch.context() as patch:
            patch.setattr(webhook_request.socket, "getaddrinfo", resolve)
            to = destination(f"http://müller.example:{port}/hook", may_be_private=True)
        assert send(to, SECRET, "id-1", 1614265330, b"{}") == (True, "status 200")
    assert asked == ["xn--mller-kva.example"]
    assert receiver.got[0][0]["host"] == f"xn--mller-kva.example:{port}"


@each(
    ("url", "header"),
    [
        ("https://[2606:4700::1111]:8443/x", "[2606:4700::1111]:8443"),
        ("https://[2606:4700::1111]/x", "[2606:4700::1111]"),
        ("https://8.8.8.8/x", "8.8.8.8"),
    ],
)
def test_the_host_of_an_address_without_a_name(url: str, header: str, monkeypatch):
    def resolve(host: str, port: int, **_: object):
        return [(0, 1, 6, "", (host, port))]

    monkeypatch.setattr(webhook_request.socket, "getaddrinfo", resolve)
    assert destination(url, may_be_private=False).host_header() == header


def test_a_receiver_that_answers_letter_by_letter_is_left_at_the_deadline(monkeypatch):
    monkeypatch.setattr(webhook_request, "DEADLINE_S", 0.5)
    is_over = threading.Event()

    def drip() -> None:
        connection, _ = server.accept()
        with connection:
            while not is_over.wait(0.1):
                connection.sendall(b"H")

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=drip)
        thread.start()
        threading.Timer(8.0, is_over.set).start()
        to = destination(f"http://127.0.0.1:{server.getsockname()[1]}/", may_be_private=True)
        began_s = time.monotonic()
        try:
            is_delivered, answer = send(to, SECRET, "id-1", 1614265330, b"{}")
        finally:
            is_over.set()
            thread.join()
    assert (is_delivered, answer) == (False, "no answer in 0 s")
    assert time.monotonic() - began_s < 5.0


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
