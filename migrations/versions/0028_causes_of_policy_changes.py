"""Why the policy on a machine changed; of earlier changes those that deployments account for."""

import sqlalchemy as sa
from alembic import op

revision = "0028"
down_revision = "0027"
branch_labels = None
depends_on = None

# The change that ended a deployment: the last one to its version up to then.
_CAUSE = sa.text(
    """
    UPDATE machine_policies SET cause = :cause WHERE machine_policy_count IN (
        SELECT (
            SELECT max(change.machine_policy_count) FROM machine_policies AS change
            WHERE change.machine_id = deployments.machine_id
            AND change.mode = deployments.mode
            AND change.policy_sha256 = deployments.policy_sha256
            AND change.since_utc <= deployments.ended_utc
        )
        FROM deployments
        WHERE deployments.outcome = 'switched' AND deployments.is_rollback = :is_rollback
    )
    """
).bindparams(sa.bindparam("is_rollback", type_=sa.Boolean()))


def upgrade() -> None:
    op.add_column("machine_policies", sa.Column("cause", sa.String(length=16), nullable=True))
    op.execute(_CAUSE.bindparams(cause="deployed", is_rollback=False))
    op.execute(_CAUSE.bindparams(cause="rolled_back", is_rollback=True))


def downgrade() -> None:
    with op.batch_alter_table("machine_policies") as batch:
        batch.drop_column("cause")
