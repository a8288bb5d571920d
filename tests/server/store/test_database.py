import threading
from datetime import timedelta

import pytest
from alembic import command
from alembic.util import CommandError
from sqlalchemy import create_engine, inspect, text
from sqlalchemy.exc import IntegrityError

from machine.conventions import Mode
from server.clock import utc_now
from server.composition import prepare_database
from server.deployments.machine_policies import version_before
from server.store import database as module
from server.store.database import Database, DatabaseError, DatabaseStanding, alembic_config, upgrade
from server.store.models import Base, Deployment, Lease, Machine, MachinePolicy, User
from tests.server.server_bench import make_settings


@pytest.fixture
def database(schema_url):
    opened = Database(schema_url)
    yield opened
    opened.close()


def user(name: str) -> User:
    return User(
        username=name, password_hash="x", role="viewer", is_disabled=False, created_utc=utc_now()
    )


def machine(machine_id: str) -> Machine:
    return Machine(
        machine_id=machine_id,
        site="yard",
        name="0",
        token_sha256="",
        is_listed=False,
        enrolled_utc=utc_now(),
    )


def test_schema_goes_up_and_down_and_agrees_with_the_models(database_url):
    upgrade(database_url)
    command.check(alembic_config(database_url))
    database = Database(database_url)
    with database.write() as session:
        session.add(machine("m001"))
        session.flush()
        session.add(Lease(machine_id="m001", epoch_count=1))
    database.close()
    command.downgrade(alembic_config(database_url), "base")
    engine = create_engine(database_url)
    assert set(inspect(engine).get_table_names()) <= {"alembic_version"}
    engine.dispose()
    upgrade(database_url)
    command.check(alembic_config(database_url))


def test_causes_of_earlier_policy_changes_come_of_the_deployments(database_url):
    """a deployed, b deployed, back to a, c at the machine's own start."""
    upgrade(database_url)
    database = Database(database_url)
    start = utc_now()
    steps = [("a", False), ("b", False), ("a", True), ("c", None)]
    with database.write() as session:
        session.add(machine("m001"))
        for count, (letter, is_rollback) in enumerate(steps, 1):
            at = start + timedelta(minutes=count)
            common = {"machine_id": "m001", "mode": "2d", "policy_sha256": letter * 64}
            session.add(MachinePolicy(**common, since_utc=at))
            session.flush()
            if is_rollback is None:
                continue
            session.add(
                Deployment(
                    **common,
                    deployment_count=count,
                    is_rollback=is_rollback,
                    reason="test",
                    created_by="eve",
                    created_utc=at,
                    outcome="switched",
                    detail="",
                    ended_utc=at + timedelta(seconds=1),
                )
            )
    database.close()
    command.downgrade(alembic_config(database_url), "0027")
    upgrade(database_url)
    database = Database(database_url)
    with database.read() as session:
        rows = session.query(MachinePolicy).order_by(MachinePolicy.machine_policy_count)
        assert [row.cause for row in rows] == ["deployed", "deployed", "rolled_back", None]
        assert version_before(session, "m001", Mode.PLANAR) == "a" * 64
    database.close()


def test_a_connection_in_use_is_closed_when_it_comes_back(database):
    with database.read() as session:
        connection = session.connection().connection
        driver = connection.driver_connection
        database.close()
        session.execute(text("SELECT 1"))
    with pytest.raises(Exception, match="clos"):
        driver.execute("SELECT 1")


def test_check_finds_a_difference(schema_url):
    engine = create_engine(schema_url)
    with engine.begin() as connection:
        connection.execute(text("ALTER TABLE impacts DROP COLUMN note"))
    engine.dispose()
    with pytest.raises(CommandError, match="upgrade operations"):
        command.check(alembic_config(schema_url))


def test_every_table_has_a_unit_on_numbers():
    from machine.conventions import UNIT_SUFFIXES

    bare = [
        f"{table.name}.{column.name}"
        for table in Base.metadata.sorted_tables
        for column in table.columns
        if column.type.python_type in (int, float) and not column.name.endswith(UNIT_SUFFIXES)
    ]
    assert not bare


def test_standing(database_url, monkeypatch):
    database = Database(database_url)
    assert database.standing() is DatabaseStanding.EMPTY
    upgrade(database_url)
    assert database.standing() is DatabaseStanding.CURRENT
    database.require_current()
    with database.engine.begin() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = '9999'"))
    assert database.standing() is DatabaseStanding.NEWER
    with pytest.raises(DatabaseError, match="newer than this software"):
        database.require_current()
    database.close()


def test_older_schema_names_the_remedy(database, monkeypatch):
    class Scripts:
        @staticmethod
        def from_config(_config):
            return Scripts()

        def get_current_head(self):
            return "9998"

        def walk_revisions(self):
            return [
                type("Script", (), {"revision": name})
                for name in (*(f"{count:04}" for count in range(1, 100)), "9998")
            ]

    monkeypatch.setattr(module, "ScriptDirectory", Scripts)
    assert database.standing() is DatabaseStanding.OLDER
    with pytest.raises(DatabaseError, match="downrange db upgrade"):
        database.require_current()


def test_a_foreign_database_is_not_touched(database_url):
    database = Database(database_url)
    with database.engine.begin() as connection:
        connection.execute(text("CREATE TABLE cats (name TEXT)"))
    with pytest.raises(DatabaseError, match="not a Downrange database"):
        database.standing()
    database.close()


def test_unreachable_server_is_a_clear_error():
    database = Database("postgresql+psycopg://nobody:secret@127.0.0.1:1/none")
    with pytest.raises(DatabaseError, match="cannot be reached") as caught:
        database.revision()
    assert "secret" not in str(caught.value)
    database.close()


def test_unsupported_database():
    with pytest.raises(DatabaseError, match="not supported"):
        Database("mysql://localhost/x")


def test_empty_database_gets_its_schema(database_url, tmp_path):
    settings = make_settings(tmp_path, tmp_path, database_url=database_url)
    for _ in range(2):
        opened = prepare_database(settings)
        assert opened.standing() is DatabaseStanding.CURRENT
        opened.close()


def test_write_commits_at_the_end_and_rolls_back_on_errors(database):
    with database.write() as session:
        session.add(user("ada"))
    with pytest.raises(RuntimeError), database.write() as session:
        session.add(user("bob"))
        session.flush()
        raise RuntimeError
    with database.read() as session:
        assert [row.username for row in session.query(User)] == ["ada"]


def test_foreign_keys_are_enforced(database):
    with pytest.raises(IntegrityError), database.write() as session:
        session.add(Lease(machine_id="nobody", epoch_count=0))


def test_times_keep_zone_and_microseconds(database):
    now = utc_now()
    with database.write() as session:
        session.add(user("ada"))
        session.get(User, "ada").created_utc = now
    with database.read() as session:
        found = session.get(User, "ada").created_utc
    assert found == now
    assert found.utcoffset().total_seconds() == 0
    with pytest.raises(Exception, match="without zone"), database.write() as session:
        session.get(User, "ada").created_utc = now.replace(tzinfo=None)


def test_many_writers_never_meet_a_locked_database(database):
    with database.write() as session:
        session.add(machine("m001"))
    errors: list[BaseException] = []

    def count_up() -> None:
        try:
            for _ in range(10):
                with database.write() as session:
                    row = session.get(Machine, "m001", with_for_update=True)
                    row.name = str(int(row.name) + 1)
                with database.read() as session:
                    session.get(Machine, "m001")
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=count_up) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not errors
    with database.read() as session:
        assert session.get(Machine, "m001").name == "80"
