"""Loads the version that a machine is to throw with; else the one before it, else the installed one."""

import logging
from pathlib import Path

from machine.conventions import Mode
from machine.errors import PolicyError
from machine.policy_card import read_policy
from machine.spec import MachineSpec
from runtime.control.policy import PolicyRunner, find_policy
from runtime.policies.slots import INSTALLED, PolicySlots

logger = logging.getLogger(__name__)


class OnBoardPolicies:
    """Reads versions from the slots' folders and from the folder of installed policies."""

    def __init__(self, slots: PolicySlots, installed_dir: Path, spec: MachineSpec) -> None:
        self._slots = slots
        self._installed_dir = installed_dir
        self._spec = spec

    def load(self, mode: Mode, policy_sha256: str | None) -> PolicyRunner:
        """Load one version.

        Args:
            mode: it must be for.
            policy_sha256: its name; empty = the installed one, None = as at a start.

        Raises:
            PolicyError: it cannot be used, or its site has not approved it, with the reason.
        """
        if policy_sha256 is None:
            return self.start(mode)
        is_installed = policy_sha256 == INSTALLED
        folder = (
            find_policy(self._installed_dir, mode)
            if is_installed
            else self._slots.version_folder(policy_sha256)
        )
        files = read_policy(folder)
        trust = self._slots.trust()
        if trust is None:
            logger.warning("bound to no site yet: %s is loaded without its approval", folder.name)
        else:
            trust.check(files, mode)
        runner = PolicyRunner(files, self._spec, has_deadline=True)
        if is_installed:
            return runner
        card = runner.card
        if card.policy_sha256 != policy_sha256 or card.mode is not mode:
            raise PolicyError(
                f"the folder of policy {policy_sha256[:12]}... for mode {mode.value} holds "
                f"{card.policy_id} ({card.policy_sha256[:12]}...) for mode {card.mode.value}; "
                "deploy it again"
            )
        return runner

    def start(self, mode: Mode) -> PolicyRunner:
        """The version in use; else the one before it, else the installed one.

        One that was rolled back from comes last.

        Raises:
            PolicyError: none can be used, with the reason of each.
        """
        slots = self._slots.of(mode)
        others = [slots.previous, INSTALLED]
        if slots.is_previous_rolled_back:
            others.reverse()
        tried: list[str] = []
        causes: list[str] = []
        for policy_sha256 in (slots.current, *others):
            if policy_sha256 is None or policy_sha256 in tried:
                continue
            tried.append(policy_sha256)
            try:
                return self.load(mode, policy_sha256)
            except PolicyError as error:
                logger.error("policy %s: %s", policy_sha256[:12] or "installed", error)
                causes.append(str(error))
        raise PolicyError("; ".join(causes))
