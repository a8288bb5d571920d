"""Validations of policy versions, one at a time in a process of its own.

Parts that have ended are kept, so that a restart throws only what is missing.
"""

import hashlib
import logging
import re
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pydantic import JsonValue

from evaluation.validation.gates import Gates
from evaluation.validation.parts import PartAnswer, read_version
from evaluation.validation.protocol import make_plan
from evaluation.validation.results import ValidationPlan
from evaluation.validation.validation import ValidationJob, ValidationListener, ValidationResult
from machine.conventions import Mode
from machine.errors import DownrangeError, PolicyError, UsageError
from machine.policy_card import CARD_FILE, read_policy
from server.accounts.accounts import Session
from server.accounts.audit_chain import SERVER, Actor, AuditChain, Entry
from server.child_process import ChildFailedError, ChildKilledError
from server.clock import new_id, utc_now
from server.errors import ApiError, ConflictError, NotFoundError
from server.job_queue import Job, JobQueue
from server.plans.policy_life import state_of
from server.plans.policy_store import PolicyStore, StoredPolicy
from server.schemas.policies import PolicyState
from server.schemas.validation import ValidationRequest, ValidationState, ValidationView
from server.store.database import Database
from server.store.validation_tables import PolicyValidation
from server.validation.gate_settings import GateSettings
from server.validation.policy_comparison import PolicyComparison
from server.validation.validation_store import ValidationStore
from server.validation.validation_worker import ValidationProcess

logger = logging.getLogger(__name__)

DETAIL_LENGTH: Final = 2000
LOG_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,120}\.mcap")


@dataclass(slots=True, kw_only=True)
class OpenValidation(Job):
    """A validation that waits or is under way."""

    policy_sha256: str


class ValidationService:
    """All validations."""

    def __init__(
        self,
        database: Database,
        audit: AuditChain,
        policies: PolicyStore,
        data_dir: Path,
        process: ValidationProcess,
    ) -> None:
        self.store = ValidationStore(database)
        self.gates = GateSettings(database, audit)
        self.comparison = PolicyComparison(database, policies, self.store)
        self._database = database
        self._audit = audit
        self._policies = policies
        self._folder = data_dir / "validations"
        self._process = process
        self.queue = JobQueue[OpenValidation](
            "validations", "validation_queue_full", self._run_or_fail
        )

    def start(self) -> None:
        """Take up what a restart cut off, and begin to work."""
        for validation_id in self.store.open_ids():
            found = _open_validation(self.store.row(validation_id))
            self.queue.add(lambda job=found: job, is_bounded=False)
        self.queue.start()

    def close(self) -> None:
        """Kill what runs; the next start goes on with it."""
        self.queue.close()

    # Asked ----------------------------------------------------------------------------------------------

    def create(
        self, policy_sha256: str, request: ValidationRequest, session: Session
    ) -> ValidationView:
        """Queue a validation of a version beside the active one.

        Raises:
            NotFoundError: no files of such a version.
            ConflictError: one of this version is open, it is retired, or there is nothing to throw at.
            TooManyRequestsError: too many are waiting.
        """
        candidate = self._policies.find(policy_sha256)
        with self._database.read() as database:
            state = state_of(database, policy_sha256)
        if state is PolicyState.RETIRED:
            raise ConflictError("policy_state", "A retired version is not validated any more.")
        if candidate is None:
            raise NotFoundError(
                "no_policy", f"There are no files of policy {policy_sha256[:12]} here."
            )
        active = self._active_beside(candidate)
        cards = [candidate.card, *([] if active is None else [active.card])]
        try:
            plan = make_plan(
                cards, request.protocol, request.throws_per_target, request.unseen_unit_count
            )
        except (UsageError, ValueError) as error:
            raise ConflictError("no_targets", f"It cannot be validated: {error}.") from error
        active_sha256 = None if active is None else active.card.policy_sha256
        card_sha256 = _card_sha256(candidate)

        def make() -> OpenValidation:
            if self._open_of(policy_sha256) is not None:
                raise ConflictError(
                    "validation_open", f"{candidate.card.policy_id} is being validated already."
                )
            return _open_validation(
                self._add(policy_sha256, card_sha256, active_sha256, plan, session)
            )

        self.queue.add(make)
        return self._view_of(policy_sha256)

    def _active_beside(self, candidate: StoredPolicy) -> StoredPolicy | None:
        try:
            active = self._policies.active(candidate.card.mode)
        except ApiError:
            return None
        is_same = active.card.policy_sha256 == candidate.card.policy_sha256
        return None if is_same else active

    def _add(
        self,
        policy_sha256: str,
        card_sha256: str,
        active_sha256: str | None,
        plan: ValidationPlan,
        session: Session,
    ) -> PolicyValidation:
        gates: Gates = self.gates.view(Mode(plan.mode)).gates
        row = PolicyValidation(
            validation_id=new_id(),
            policy_sha256=policy_sha256,
            active_sha256=active_sha256,
            card_sha256=card_sha256,
            created_by=session.username,
            created_utc=utc_now(),
            started_utc=None,
            ended_utc=None,
            state=ValidationState.QUEUED.value,
            detail="",
            plan=plan.model_dump(mode="json"),
            gates=gates.model_dump(mode="json"),
            is_passed=None,
            result=None,
        )
        with self._database.write() as database:
            database.add(row)
            database.flush()
            entry = self._entry(session.actor, "policy.validate", row.validation_id, policy_sha256)
            self._audit.append(database, entry)
        return row

    def _entry(self, actor: Actor, action: str, validation_id: str, policy_sha256: str) -> Entry:
        detail: dict[str, JsonValue] = {
            "validation_id": validation_id,
            "policy_sha256": policy_sha256,
            "policy_id": self._policies.name_of(policy_sha256),
        }
        return Entry(actor, action, "fact", detail=detail)

    def cancel(self, policy_sha256: str, session: Session) -> ValidationView:
        """Stop the open validation of a version.

        Raises:
            ConflictError: none is open.
        """
        run = self._open_of(policy_sha256)
        if run is None:
            raise ConflictError("no_open_validation", "This version is not being validated.")
        is_waiting = self.queue.cancel(run)
        entry = self._entry(session.actor, "policy.validate.cancel", run.job_id, policy_sha256)
        self._audit.record(entry)
        if is_waiting:
            self.store.end(run.job_id, ValidationState.CANCELLED, "")
        return self._view_of(policy_sha256)

    def view(self, policy_sha256: str) -> ValidationView | None:
        """The newest validation of a version, with its result or progress; None before the first."""
        found = self.store.newest(policy_sha256)
        return self._with_progress(found[0]) if found else None

    def log(self, validation_id: str, name: str) -> Path:
        """The log of a throw that failed.

        Raises:
            NotFoundError: there is none.
        """
        self.store.row(validation_id)
        path = self._folder / validation_id / name
        if LOG_NAME.fullmatch(name) is None or not path.is_file():
            raise NotFoundError("no_log", f"This validation has no log '{name[:120]}'.")
        return path

    def _view_of(self, policy_sha256: str) -> ValidationView:
        view = self.view(policy_sha256)
        if view is None:
            raise NotFoundError("no_validation", "This version has no validation.")
        return view

    def _with_progress(self, view: ValidationView) -> ValidationView:
        run = self.queue.find(view.validation_id)
        if run is None or view.ended_utc is not None:
            return view
        return view.model_copy(update={"progress_ratio": run.progress_ratio, "step": run.step})

    def _open_of(self, policy_sha256: str) -> OpenValidation | None:
        runs = (run for run in self.queue.open_jobs() if run.policy_sha256 == policy_sha256)
        return next((run for run in runs if not run.cancelled.is_set()), None)

    # Work -----------------------------------------------------------------------------------------------

    def _run_or_fail(self, run: OpenValidation) -> None:
        try:
            self._run(run)
        except Exception:
            with suppress(Exception):
                text = "The server could not keep it; its log says more."
                self.store.end(run.job_id, ValidationState.FAILED, text)
            raise

    def _run(self, run: OpenValidation) -> None:
        row = self.store.begin(run.job_id)
        run.step = "starting"
        try:
            result = self._process.run(
                self._job(row),
                ValidationListener(run.report, lambda name, answer: self._keep(run, name, answer)),
                lambda: self.queue.must_end(run),
            )
        except ChildKilledError:
            if run.cancelled.is_set():
                self.store.end(run.job_id, ValidationState.CANCELLED, "")
        except (ChildFailedError, DownrangeError, OSError) as error:
            self.store.end(run.job_id, ValidationState.FAILED, str(error)[:DETAIL_LENGTH])
        else:
            self._finish(run, result)

    def _job(self, row: PolicyValidation) -> ValidationJob:
        """The validation as it travels to its process.

        Raises:
            DownrangeError: the files of a version are gone or cannot be read.
        """
        versions: list[StoredPolicy] = []
        for sha256 in (row.policy_sha256, row.active_sha256):
            if sha256 is None:
                continue
            found = self._policies.find(sha256)
            if found is None:
                raise NotFoundError(
                    "no_policy", f"The files of policy {sha256[:12]} are gone. Validate again."
                )
            versions.append(found)
        files = [read_version(version.folder, version.card.policy_sha256) for version in versions]
        if hashlib.sha256(files[0].files[CARD_FILE]).hexdigest() != row.card_sha256:
            raise ConflictError(
                "card_changed", "Its card was altered since it was asked for. Validate again."
            )
        return ValidationJob(
            plan=ValidationPlan.model_validate(row.plan),
            gates=Gates.model_validate(row.gates),
            candidate=files[0],
            active=files[1] if len(files) > 1 else None,
            finished=self.store.parts(row.validation_id),
        )

    def _keep(self, run: OpenValidation, name: str, answer: PartAnswer) -> None:
        """Keep a part: its logs first, so that no row names a log that is not there."""
        if answer.logs:
            folder = self._folder / run.job_id
            folder.mkdir(parents=True, exist_ok=True)
            for file, content in answer.logs.items():
                part = folder / f"{file}.part"
                part.write_bytes(content)
                part.replace(folder / file)
        self.store.keep_part(run.job_id, name, answer.landings)

    def _finish(self, run: OpenValidation, result: ValidationResult) -> None:
        self.store.end(run.job_id, ValidationState.DONE, "", result)
        action = "policy.validate.passed" if result.is_passed else "policy.validate.not_passed"
        self._audit.record(self._entry(SERVER, action, run.job_id, run.policy_sha256))


def _card_sha256(policy: StoredPolicy) -> str:
    try:
        return read_policy(policy.folder).card_sha256
    except PolicyError as error:
        raise NotFoundError("no_policy", f"Its files cannot be read: {error}.") from error


def _open_validation(row: PolicyValidation) -> OpenValidation:
    return OpenValidation(job_id=row.validation_id, policy_sha256=row.policy_sha256)
