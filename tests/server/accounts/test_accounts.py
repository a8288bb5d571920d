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


def test_brake_closes_after_failures_and_opens_again():
    now = [0.0]
    brake = LoginRateLimit(lambda: now[0])
    for _ in range(LoginRateLimit.NAME_LIMIT):
        brake.check("ada", "a")
        brake.fail("ada", "a")
    with pytest.raises(TooManyRequestsError, match="wait 300 s"):
        brake.check("ada", "a")
    brake.check("ada", "b")
    brake.check("bob", "a")
    now[0] = LoginRateLimit.WINDOW_S + 1.0
    brake.check("ada", "a")


def test_brake_limits_an_address_over_all_names_and_forgets_old_keys():
    brake = LoginRateLimit(lambda: 0.0)
    for index in range(LoginRateLimit.ADDRESS_LIMIT):
        brake.fail(f"u{index}", "a")
    with pytest.raises(TooManyRequestsError):
        brake.check("someone", "a")
    for index in range(LoginRateLimit.KEY_LIMIT + 10):
        brake.fail("x", str(index))
    brake.check("someone", "a")


def test_success_forgets_failures():
    brake = LoginRateLimit(lambda: 0.0)
    for _ in range(LoginRateLimit.NAME_LIMIT - 1):
        brake.fail("ada", "a")
    brake.succeed("ada", "a")
    for _ in range(LoginRateLimit.NAME_LIMIT - 1):
        brake.fail("ada", "a")
    brake.check("ada", "a")
