from datetime import timedelta
from itertools import pairwise

import pytest

from server.accounts.accounts import PERMISSIONS, LoginRateLimit, Session
from server.clock import utc_now
from server.errors import NotSignedInError, TooManyRequestsError
from server.schemas.console import Permission, Role
from server.store.models import LoginSession, User
from tests.cases import each

PASSWORD = "correct horse battery"


def test_roles_grow(assembled):
    ordered = [PERMISSIONS[role] for role in Role]
    for less, more in pairwise(ordered):
        assert less < more
    assert Permission.STOP in PERMISSIONS[Role.VIEWER]
    assert Permission.THROW not in PERMISSIONS[Role.VIEWER]
    assert Permission.STOP_CLEAR not in PERMISSIONS[Role.OPERATOR]


def test_sessions_live_on_the_server(assembled):
    accounts, database = assembled.parts.accounts, assembled.parts.database
    ended: list[Session] = []
    accounts.on_session_end(ended.append)
    accounts.create_user("ada", PASSWORD, Role.OPERATOR)
    token, session = accounts.login("ada", PASSWORD, "10.0.0.1")
    assert accounts.session_of(token) == session
    with database.read() as reader:
        stored = reader.query(LoginSession).one()
        assert token not in (stored.token_sha256, stored.session_id)
        assert PASSWORD not in reader.get(User, "ada").password_hash
    accounts.logout(session)
    assert accounts.session_of(token) is None
    assert ended == [session]


@each("token", [None, "", "x", "y" * 500, "\x00"])
def test_strange_tokens_are_no_session(assembled, token):
    assert assembled.parts.accounts.session_of(token) is None


def test_expired_and_disabled_sessions_end(assembled):
    accounts, database = assembled.parts.accounts, assembled.parts.database
    accounts.create_user("ada", PASSWORD, Role.OPERATOR)
    token, session = accounts.login("ada", PASSWORD, "")
    with database.write() as writer:
        writer.get(LoginSession, session.session_id).expires_utc = utc_now() - timedelta(seconds=1)
    assert accounts.session_of(token) is None
    token, _ = accounts.login("ada", PASSWORD, "")
    with database.write() as writer:
        writer.get(User, "ada").is_disabled = True
    assert accounts.session_of(token) is None
    with pytest.raises(NotSignedInError):
        accounts.login("ada", PASSWORD, "")


def test_role_changes_act_at_once(assembled):
    accounts, database = assembled.parts.accounts, assembled.parts.database
    accounts.create_user("ada", PASSWORD, Role.OPERATOR)
    token, _ = accounts.login("ada", PASSWORD, "")
    with database.write() as writer:
        writer.get(User, "ada").role = "viewer"
    assert accounts.session_of(token).role is Role.VIEWER


def test_first_users_get_a_private_file_once(assembled, tmp_path):
    accounts = assembled.parts.accounts
    accounts.create_first_users(tmp_path)
    file = tmp_path / "demo-login.txt"
    assert file.stat().st_mode & 0o777 == 0o600
    logins = dict(line.split() for line in file.read_text().splitlines())
    assert set(logins) == {"operator", "admin"}
    assert accounts.login("admin", logins["admin"], "")[1].role is Role.ADMIN
    text = file.read_text()
    accounts.create_first_users(tmp_path)
    assert file.read_text() == text


def test_wrong_name_and_wrong_password_answer_alike(assembled):
    accounts = assembled.parts.accounts
    accounts.create_user("ada", PASSWORD, Role.OPERATOR)
    texts = set()
    for name, password in (("ada", "wrong"), ("nobody", PASSWORD)):
        with pytest.raises(NotSignedInError) as caught:
            accounts.login(name, password, "")
        texts.add((caught.value.code, str(caught.value)))
    assert len(texts) == 1


def test_limit_closes_after_failures_and_opens_again():
    now = [0.0]
    limit = LoginRateLimit(lambda: now[0])
    for _ in range(LoginRateLimit.NAME_LIMIT):
        limit.attempt("ada", "a")
    with pytest.raises(TooManyRequestsError, match="wait 300 s"):
        limit.attempt("ada", "a")
    limit.attempt("ada", "b")
    limit.attempt("bob", "a")
    now[0] = LoginRateLimit.WINDOW_S + 1.0
    limit.attempt("ada", "a")


def test_limit_limits_an_address_over_all_names_and_forgets_old_keys():
    limit = LoginRateLimit(lambda: 0.0)
    for index in range(LoginRateLimit.ADDRESS_LIMIT):
        limit.attempt(f"u{index}", "a")
    with pytest.raises(TooManyRequestsError):
        limit.attempt("someone", "a")
    for index in range(LoginRateLimit.KEY_LIMIT + 10):
        limit.attempt("x", str(index))
    limit.attempt("someone", "a")


def test_success_forgets_failures():
    limit = LoginRateLimit(lambda: 0.0)
    for _ in range(LoginRateLimit.NAME_LIMIT - 1):
        limit.attempt("ada", "a")
    limit.succeed("ada", "a")
    for _ in range(LoginRateLimit.NAME_LIMIT - 1):
        limit.attempt("ada", "a")
    limit.attempt("ada", "a")


def test_guesses_do_not_lock_out_a_known_device_nor_another_address(assembled):
    accounts, devices = assembled.parts.accounts, assembled.parts.devices
    accounts.create_user("ada", PASSWORD, Role.OPERATOR)
    device_id = devices.device_of(devices.issue("ada"), "ada")
    for _ in range(LoginRateLimit.NAME_LIMIT):
        with pytest.raises(NotSignedInError):
            accounts.login("ada", "guess", "10.0.0.1")
    with pytest.raises(TooManyRequestsError):
        accounts.login("ada", PASSWORD, "10.0.0.1")
    accounts.login("ada", PASSWORD, "10.0.0.1", device_id)
    accounts.login("ada", PASSWORD, "10.0.0.2")
    # A device has a limit too, or a stolen cookie would be a way around.
    for _ in range(LoginRateLimit.NAME_LIMIT):
        with pytest.raises(NotSignedInError):
            accounts.login("ada", "guess", "10.0.0.1", device_id)
    with pytest.raises(TooManyRequestsError):
        accounts.login("ada", PASSWORD, "10.0.0.1", device_id)


def test_device_cookies_cannot_be_made_up_or_passed_on(assembled):
    devices = assembled.parts.devices
    value = devices.issue("ada")
    device_id = devices.device_of(value, "ada")
    assert devices.device_of(devices.issue("ada", device_id), "ada") == device_id
    for forged in (None, "", "x", value[:-1], value.replace(".", ""), f"{device_id}.{'0' * 64}"):
        assert devices.device_of(forged, "ada") is None
    assert devices.device_of(value, "bob") is None
    key = assembled.parts.settings.data_dir / "device-cookie.key"
    assert key.stat().st_mode & 0o777 == 0o600


def test_attempts_at_one_time_count_before_their_passwords_are_checked():
    limit = LoginRateLimit(lambda: 0.0)
    refused = 0
    for _ in range(40):
        try:
            limit.attempt("ada", "a")
        except TooManyRequestsError:
            refused += 1
    assert refused == 40 - LoginRateLimit.NAME_LIMIT


def test_addresses_of_one_ipv6_network_are_one_caller():
    limit = LoginRateLimit(lambda: 0.0)
    for index in range(LoginRateLimit.NAME_LIMIT):
        limit.attempt("ada", f"2001:db8::{index + 1}")
    with pytest.raises(TooManyRequestsError):
        limit.attempt("ada", "2001:db8::ffff")
    limit.attempt("ada", "2001:db8:0:1::1")
    limit.attempt("ada", "::ffff:10.0.0.1")
