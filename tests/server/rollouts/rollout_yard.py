"""Machines with a version on board, their answers and throws, put into a server's database."""

import numpy as np

from machine.messages import EventKind, MachineEvent
from server.clock import new_id, utc_now
from server.schemas.console import Role
from server.store.models import MachinePolicy, Throw

SD_M = (0.05, 0.03)


class RolloutYard:
    """Machines m001 and m002 with the active version in 2D, thrown often enough to compare with."""

    def __init__(self, assembled, before_count=40):
        self.parts = assembled.parts
        self.parts.approvals.start()
        self.rollouts = self.parts.rollouts
        self.eve = assembled.session("eve", Role.ENGINEER)
        names = {p.card.policy_id: p.card.policy_sha256 for p in self.parts.policies.present()}
        self.old, self.new = names["swing-2d"], names["waits-2d"]
        self.rng = np.random.default_rng(7)
        self._sequence = 0
        for machine_id in ("m001", "m002"):
            self.parts.registry.get(machine_id).is_listed = True
            with self.parts.database.write() as database:
                database.add(
                    MachinePolicy(
                        machine_id=machine_id,
                        mode="2d",
                        policy_sha256=self.old,
                        since_utc=utc_now(),
                    )
                )
            self.throw(machine_id, before_count, policy_sha256=self.old)

    def tell(self, machine_id, kind, **data):
        """The machine answers its newest deployment."""
        self._sequence += 1
        newest = self.parts.deployments.list(machine_id)[0]
        event = MachineEvent(
            machine_id=machine_id,
            boot_id="b",
            sequence_count=self._sequence,
            t_mono_ns=self._sequence,
            t_utc=utc_now().isoformat(),
            kind=kind,
            data={
                "mode": "2d",
                "policy_sha256": newest.policy_sha256,
                "deployment_count": newest.deployment_count,
                **data,
            },
        )
        with self.parts.database.write() as database:
            self.parts.machine_policies.record(database, event)
            self.parts.deployments.record(database, event)

    def switch(self, machine_id):
        self.tell(machine_id, EventKind.POLICY_SWITCHED)

    def throw(
        self, machine_id, count, *, ratio=1.0, policy_sha256=None, outcome="landed", is_own=None
    ):
        scatter = self.rng.standard_normal((count, 2)) * SD_M * ratio
        with self.parts.database.write() as database:
            for along_m, across_m in scatter.tolist():
                database.add(
                    Throw(
                        throw_id=new_id(),
                        machine_id=machine_id,
                        plan_id="p",
                        session_id="s",
                        created_utc=utc_now(),
                        operator="ada",
                        epoch_count=1,
                        mode="2d",
                        target_x_m=9.0,
                        target_y_m=0.0,
                        target_z_m=0.0,
                        range_m=9.0,
                        policy_id="p",
                        policy_sha256=policy_sha256 or self.new,
                        phase="ended",
                        outcome=outcome,
                        is_policys_own=is_own,
                        measured_downrange_error_m=along_m,
                        measured_crossrange_error_m=across_m,
                        predicted_sd_downrange_m=SD_M[0],
                        predicted_sd_crossrange_m=SD_M[1],
                    )
                )
