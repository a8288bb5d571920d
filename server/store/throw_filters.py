"""Conditions on throws that several queries share."""

from sqlalchemy import ColumnElement, exists

from server.store.models import Plan, Throw


def threw_a_ball() -> ColumnElement[bool]:
    """Whether a throw's load was a ball, as previews assume; bulk material misses and scatters otherwise."""
    of_material = exists().where(Plan.plan_id == Throw.plan_id, Plan.material.is_not(None))
    # The query around it may join plans, too.
    return ~of_material.correlate(Throw)
