import json
import threading

import pytest
from sqlalchemy import text
from sqlalchemy.exc import DatabaseError as SqlDatabaseError

from server.accounts.audit_chain import Actor, Entry
from server.store.models import Audit
from tests.cases import each

ADA = Actor("ada", "s-1")


def fill(assembled, count=5):
    for index in range(count):
        assembled.parts.audit.record(
            Entry(ADA, "load", "intent", machine_id="m001", detail={"n": index, "x": 0.1 * index})
        )


def unprotected(assembled, statement):
    """Change rows as someone with the database's own password could."""
    database = assembled.parts.database
    with database.engine.begin() as connection:
        if database.dialect == "sqlite":
            for verb in ("UPDATE", "DELETE"):
                connection.execute(text(f"DROP TRIGGER audit_refuses_{verb}"))
        else:
            connection.execute(text("ALTER TABLE audit DISABLE TRIGGER ALL"))
        connection.execute(text(statement))


def test_a_whole_chain_is_intact(assembled):
    fill(assembled)
    verdict = assembled.parts.audit.verify()
    assert verdict.is_intact
    assert verdict.row_count == 5


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE audit SET actor = 'eve' WHERE sequence_count = 3",
        "UPDATE audit SET detail_json = '{}' WHERE sequence_count = 3",
        "UPDATE audit SET phase = 'fact' WHERE sequence_count = 3",
        "UPDATE audit SET previous_sha256 = row_sha256 WHERE sequence_count = 3",
        "DELETE FROM audit WHERE sequence_count = 3",
    ],
)
def test_tampering_is_found_at_the_row(assembled, statement):
    fill(assembled)
    unprotected(assembled, statement)
    verdict = assembled.parts.audit.verify()
    assert not verdict.is_intact
    assert verdict.first_bad_sequence_count in (3, 4)
    assert verdict.problem


def test_a_cut_off_end_is_found_by_the_anchor(assembled):
    fill(assembled)
    assembled.parts.audit.anchor()
    unprotected(assembled, "DELETE FROM audit WHERE sequence_count > 3")
    verdict = assembled.parts.audit.verify()
    assert not verdict.is_intact
    assert verdict.first_bad_sequence_count == 5


def test_a_rewritten_chain_is_found_by_the_anchor(assembled):
    fill(assembled, 2)
    assembled.parts.audit.anchor()
    unprotected(assembled, "DELETE FROM audit")
    for _ in range(3):
        assembled.parts.audit.record(Entry(Actor("eve"), "nothing", "fact"))
    assert not assembled.parts.audit.verify().is_intact


@each("statement", ["UPDATE audit SET actor = 'eve'", "DELETE FROM audit", "TRUNCATE audit"])
def test_the_database_itself_refuses_changes(assembled, statement):
    fill(assembled)
    if statement.startswith("TRUNCATE") and assembled.parts.database.dialect == "sqlite":
        statement = "DELETE FROM audit WHERE 1"
    with (
        pytest.raises(SqlDatabaseError, match="never changed or deleted"),
        assembled.parts.database.engine.begin() as connection,
    ):
        connection.execute(text(statement))
    assert assembled.parts.audit.verify().is_intact


def test_appends_from_many_threads_form_one_chain(assembled):
    errors: list[BaseException] = []

    def work() -> None:
        try:
            fill(assembled, 10)
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=work) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not errors
    verdict = assembled.parts.audit.verify()
    assert verdict.is_intact
    assert verdict.row_count == 60


def test_a_failed_transaction_leaves_no_row(assembled):
    database, audit = assembled.parts.database, assembled.parts.audit
    with pytest.raises(RuntimeError), database.write() as session:
        audit.append(session, Entry(ADA, "load", "intent"))
        raise RuntimeError
    fill(assembled, 1)
    with database.read() as session:
        rows = session.query(Audit).all()
    assert [row.sequence_count for row in rows] == [1]
    assert json.loads(rows[0].detail_json) == {"n": 0, "x": 0.0}
