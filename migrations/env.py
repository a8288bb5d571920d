"""Runs migrations on the database that the caller names (server.store.database, `downrange db`)."""

from alembic import context
from sqlalchemy import Connection

from server.settings import load_settings
from server.store import (  # noqa: F401  their tables belong to Base
    aim_tables,
    alert_models,
    enrolment_models,
    job_tables,
)
from server.store.database import Database
from server.store.validation_tables import PolicyValidation


def _run(connection: Connection) -> None:
    context.configure(
        connection=connection,
        # The tables of all modules share one description; this one is imported last.
        target_metadata=PolicyValidation.metadata,
        # SQLite cannot alter columns in place: Alembic copies the table instead.
        render_as_batch=connection.dialect.name == "sqlite",
        compare_type=True,
        transaction_per_migration=True,
    )
    with context.begin_transaction():
        context.run_migrations()


def _main() -> None:
    if context.is_offline_mode():
        raise SystemExit("migrations need the database; there is no offline mode")
    given = context.config.attributes.get("url")
    database = Database(given or load_settings().resolved_database_url)
    try:
        with database.engine.connect() as connection:
            _run(connection)
            connection.commit()
    finally:
        database.close()


_main()
