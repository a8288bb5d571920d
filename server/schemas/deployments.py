"""Bodies of the HTTP interface for policies on machines."""

from datetime import datetime

from machine.conventions import Mode
from server.schemas.console import View


class MachinePolicyView(View):
    """The policy of one mode."""

    mode: Mode
    policy_sha256: str | None
    """None: no usable policy was on board."""
    policy_id: str | None
    since_utc: datetime
    """By the machine's clock."""


class MachinePoliciesView(View):
    """What a machine had on board at a time."""

    machine_id: str
    at_utc: datetime
    policies: tuple[MachinePolicyView, ...]
    """Empty before the machine's first start."""
