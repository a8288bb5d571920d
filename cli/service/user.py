"""`downrange user`: who may sign in, and as what; on the server's computer, also while the server runs."""

import secrets
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import tyro

from machine.errors import UsageError
from server.accounts.audit_chain import AuditChain
from server.accounts.user_admin import UserAdmin
from server.schemas.console import Role
from server.settings import load_settings
from server.store.database import Database

Name = Annotated[str, tyro.conf.Positional]
RoleName = Annotated[Role, tyro.conf.EnumChoicesFromValues]


def add(
    name: Name, /, *, role: RoleName, password_file: Path | None = None, data: Path | None = None
) -> int:
    """Make an account; without a password file a password is made and shown once.

    Args:
        name: what the person signs in with.
        role: viewer, operator, supervisor, engineer or admin (docs/operations.md).
        password_file: file with the password alone.
        data: the server's data folder; DOWNRANGE_DATA_DIR if not given.
    """
    password = _password(password_file)
    with _people(data) as people:
        people.add(name, password, role)
    _tell(name, f"added as {role.value}", password, password_file)
    return 0


def password(name: Name, /, *, password_file: Path | None = None, data: Path | None = None) -> int:
    """Give a person another password and end the person's sessions.

    Args:
        name: whose.
        password_file: file with the password alone; without it one is made and shown once.
        data: the server's data folder; DOWNRANGE_DATA_DIR if not given.
    """
    fresh = _password(password_file)
    with _people(data) as people:
        people.set_password(name, fresh)
    _tell(name, "has another password", fresh, password_file)
    return 0


def role(
    name: Name, role: Annotated[RoleName, tyro.conf.Positional], /, data: Path | None = None
) -> int:
    """Give a person another role; it counts at once.

    Args:
        name: whose.
        role: viewer, operator, supervisor, engineer or admin.
        data: the server's data folder; DOWNRANGE_DATA_DIR if not given.
    """
    with _people(data) as people:
        people.set_role(name, role)
    print(f"{name}: {role.value} from now on")
    return 0


def disable(name: Name, /, data: Path | None = None) -> int:
    """Keep a person out and end the person's sessions; throws and audit keep the name.

    Args:
        name: whom.
        data: the server's data folder; DOWNRANGE_DATA_DIR if not given.
    """
    with _people(data) as people:
        people.set_disabled(name, is_disabled=True)
    print(f"{name}: may not sign in any more")
    return 0


def enable(name: Name, /, data: Path | None = None) -> int:
    """Let a person who was kept out sign in again.

    Args:
        name: whom.
        data: the server's data folder; DOWNRANGE_DATA_DIR if not given.
    """
    with _people(data) as people:
        people.set_disabled(name, is_disabled=False)
    print(f"{name}: may sign in again")
    return 0


def listed(data: Path | None = None) -> int:
    """Show who may sign in, and as what.

    Args:
        data: the server's data folder; DOWNRANGE_DATA_DIR if not given.
    """
    with _people(data) as people:
        for person in people.listed():
            print(
                f"{person.username:<20} {person.role.value:<10} {'disabled' * person.is_disabled}"
            )
    return 0


ACTIONS: dict[str, Callable[..., int]] = {
    "add": add,
    "password": password,
    "role": role,
    "disable": disable,
    "enable": enable,
    "list": listed,
}


@contextmanager
def _people(data: Path | None) -> Generator[UserAdmin]:
    settings = load_settings(data_dir=data)
    database = Database(settings.resolved_database_url)
    try:
        database.require_current()
        yield UserAdmin(database, AuditChain(database, settings.data_dir / "audit-anchors.jsonl"))
    finally:
        database.close()


def _password(file: Path | None) -> str:
    if file is None:
        return secrets.token_urlsafe(12)
    try:
        return file.read_text(encoding="utf-8").strip()
    except OSError as error:
        raise UsageError(f"{file} cannot be read: {error.strerror}") from error


def _tell(name: str, what: str, password: str, file: Path | None) -> None:
    print(f"{name}: {what}" + ("" if file else f"; password {password} (shown once)"))
