import pytest

from machine.errors import UsageError
from server.settings import load_settings
from tests.cases import each


def test_environment_sets_fields(monkeypatch):
    monkeypatch.setenv("DOWNRANGE_PORT", "8123")
    monkeypatch.setenv("DOWNRANGE_SITE", "north")
    monkeypatch.setenv("DOWNRANGE_ORIGINS", "https://a.example/, https://b.example")
    settings = load_settings()
    assert (settings.port_count, settings.site) == (8123, "north")
    assert settings.allowed_origins == {"https://a.example", "https://b.example"}


def test_arguments_take_precedence(monkeypatch):
    monkeypatch.setenv("DOWNRANGE_PORT", "8123")
    assert load_settings(port_count=9000).port_count == 9000
    assert load_settings(port_count=None).port_count == 8123


def test_unknown_variable_is_refused_with_the_known_ones(monkeypatch):
    monkeypatch.setenv("DOWNRANGE_PROT", "8123")
    with pytest.raises(UsageError, match=r"DOWNRANGE_PROT.*DOWNRANGE_PORT"):
        load_settings()


def test_client_variables_do_not_disturb(monkeypatch):
    monkeypatch.setenv("DOWNRANGE_USER", "operator")
    load_settings()


@each(
    ("name", "value"),
    [
        ("PORT", "70000"),
        ("PORT", "http"),
        ("LEASE_TTL_S", "0"),
        ("SITE", "North Yard"),
        ("SITE", "a/b"),
    ],
)
def test_values_out_of_range_are_refused(monkeypatch, name, value):
    monkeypatch.setenv(f"DOWNRANGE_{name}", value)
    with pytest.raises(UsageError, match="settings cannot be used"):
        load_settings()


@each(
    "changes",
    [
        {"link_listen": "tls/0.0.0.0:7447"},
        {"link_listen": "tls/0.0.0.0:7447", "link_certificate": "c.pem"},
        {"link_certificate": "c.pem", "link_private_key": "k.pem"},
    ],
)
def test_a_certificate_goes_with_a_tls_endpoint(changes):
    with pytest.raises(UsageError, match="link_certificate and link_private_key"):
        load_settings(**changes)


@each(
    ("listen", "in_the_clear"),
    [
        ("tcp/127.0.0.1:7447", False),
        ("tcp/localhost:7447", False),
        ("tcp/[::1]:7447", False),
        ("tcp/0.0.0.0:7447", True),
        ("tcp/[::]:7447", True),
        ("tcp/10.0.0.5:7447", True),
        ("udp/10.0.0.5:7447", True),
    ],
)
def test_a_link_beyond_this_computer_without_encryption_is_noticed(listen, in_the_clear):
    assert load_settings(link_listen=listen).is_link_in_the_clear is in_the_clear


def test_secrets_are_hidden_when_printed():
    settings = load_settings(database_url="postgresql://me:hunter2@db/downrange")
    assert "hunter2" not in "\n".join(settings.lines())
    assert settings.resolved_database_url == "postgresql+psycopg://me:hunter2@db/downrange"


def test_own_origins_by_default():
    settings = load_settings(port_count=8001)
    assert settings.allowed_origins == {"http://127.0.0.1:8001", "http://localhost:8001"}
    everywhere = load_settings(port_count=8001, host="0.0.0.0")
    assert "http://0.0.0.0:8001" not in everywhere.allowed_origins
