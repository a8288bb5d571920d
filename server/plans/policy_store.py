"""Policy versions: the files in the policies folder, the active ones, and all versions ever seen.

A policy whose file does not match its card is shown with its problem and never used.
"""

import contextlib
import threading
import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, ConfigDict
from sqlalchemy import func, select
from sqlalchemy.exc import DataError, IntegrityError
from sqlalchemy.orm import Session as DatabaseSession

from machine.conventions import Mode
from machine.errors import PolicyError
from machine.messages import RejectReason
from machine.policy_card import CARD_FILE, PolicyCard, load_card
from machine.reach import MIN_RANGE_M, reach_m
from machine.spec import MachineSpec
from runtime.control.observation import PACE_NAME
from runtime.control.policy import ACTIVE_FILE, find_policy
from server.accounts.audit_chain import SERVER
from server.clock import utc_now
from server.errors import ApiError, NotFoundError, from_reason
from server.plans.policy_life import change_state, state_of, states
from server.schemas.console import ModeReach, ReachView
from server.schemas.history import PolicyView
from server.schemas.policies import PolicyState
from server.store.database import Database
from server.store.models import Policy, Throw

LOOK_PERIOD_S = 1.0
UPLOAD_FILE = "upload.json"
FOUND_REASON = "found in the server's policies folder"


@dataclass(frozen=True, slots=True)
class StoredPolicy:
    """A usable policy version."""

    folder: Path
    card: PolicyCard


class UploadRecord(BaseModel):
    """Who brought a version, in its folder: the rename that makes it a version carries this along."""

    model_config = ConfigDict(frozen=True)
    uploaded_by: str
    reason: str


class PolicyStore:
    """The folders of policies, read again when they changed."""

    def __init__(
        self, database: Database, folder: Path, spec: MachineSpec, uploaded_dir: Path | None = None
    ) -> None:
        """Begin.

        Args:
            database: remembers all versions.
            folder: of versions, with `active.json`.
            spec: machine type.
            uploaded_dir: folder of versions that people have uploaded.
        """
        self._database = database
        self._folder = folder
        self._uploaded_dir = uploaded_dir
        self._spec = spec
        self._lock = threading.Lock()
        self._looked_s = -1e9
        self._stamp: tuple[tuple[str, int], ...] | None = None
        self._present: dict[str, StoredPolicy] = {}
        self._active: dict[Mode, StoredPolicy] = {}
        self._problems: dict[str, str] = {}

    def look_again(self) -> None:
        """Read the folders at once: a version was taken in."""
        with self._lock:
            self._looked_s = -1e9
        self.refresh()

    def refresh(self) -> None:
        """Read the folder if a file of it changed; looks at most once in `LOOK_PERIOD_S`."""
        with self._lock:
            now_s = time.monotonic()
            if now_s - self._looked_s < LOOK_PERIOD_S:
                return
            self._looked_s = now_s
            stamp = self._read_stamp()
            if stamp == self._stamp:
                return
            self._present, self._problems, self._active = {}, {}, {}
            found: dict[Path, str] = {}
            for folder in self._folders():
                try:
                    card = load_card(folder)
                    sha256 = card.policy_sha256
                    if sha256 not in self._present:
                        # Installed folders come first: an uploaded copy takes no version's place.
                        self._remember(StoredPolicy(folder, card))
                    found[folder] = sha256
                except PolicyError as error:
                    self._problems[folder.name] = str(error)
            for mode in Mode:
                self._read_active(mode, found)
            # Last: what failed on the way is tried again.
            self._stamp = stamp

    def _read_active(self, mode: Mode, versions: Mapping[Path, str]) -> None:
        try:
            folder = find_policy(self._folder, mode)
        except PolicyError as error:
            self._problems[mode.value] = str(error)
            return
        found = self._present.get(versions.get(folder, ""))
        if found is None or found.card.mode is not mode:
            cause = self._problems.get(folder.name, f"its card is not for mode {mode.value}")
            self._problems[mode.value] = f"active policy {folder.name} cannot be used: {cause}"
        elif found.card.model_sha256 != self._spec.sha256:
            self._problems[mode.value] = (
                f"active policy {folder.name} is for machine model "
                f"{found.card.model_sha256[:12]}..., this server's is {self._spec.sha256[:12]}..."
            )
        else:
            self._active[mode] = found

    def _folders(self) -> list[Path]:
        roots = [root for root in (self._folder, self._uploaded_dir) if root and root.is_dir()]
        return [
            path
            for root in roots
            for path in sorted(root.iterdir())
            if not path.name.startswith(".") and (path / CARD_FILE).is_file()
        ]

    def _read_stamp(self) -> tuple[tuple[str, int], ...]:
        files = [self._folder / ACTIVE_FILE]
        files += [file for folder in self._folders() for file in folder.iterdir()]
        return tuple((str(f), f.stat().st_mtime_ns) for f in files if f.is_file())

    def _remember(self, policy: StoredPolicy) -> None:
        """Take a version into the history and into use.

        Raises:
            PolicyError: the database does not take its card.
        """
        try:
            with self._database.write() as session:
                self._store(session, policy)
        except (DataError, IntegrityError) as error:
            raise PolicyError(f"{policy.folder} cannot be stored: {error.orig}") from error
        self._present[policy.card.policy_sha256] = policy

    def _store(self, session: DatabaseSession, policy: StoredPolicy) -> None:
        sha256 = policy.card.policy_sha256
        if session.get(Policy, sha256) is None:
            session.add(
                Policy(
                    policy_sha256=sha256,
                    policy_id=policy.card.policy_id,
                    mode=policy.card.mode.value,
                    card=policy.card.model_dump(mode="json"),
                    first_seen_utc=utc_now(),
                )
            )
            session.flush()
        if state_of(session, sha256) is None:
            record = _upload_record(policy.folder)
            change_state(
                session,
                sha256,
                PolicyState.UPLOADED,
                actor=record.uploaded_by,
                reason=record.reason,
            )

    def is_installed(self, policy: StoredPolicy) -> bool:
        """Whether a version lies in the folder of the installation, and not with people's uploads."""
        return policy.folder.parent == self._folder

    def active(self, mode: Mode) -> StoredPolicy:
        """The policy to throw with.

        Raises:
            ApiError: none that can be used, with the cause.
        """
        self.refresh()
        policy = self._active.get(mode)
        if policy is None:
            raise self._unusable(mode)
        return policy

    def on_machine(self, mode: Mode, policy_sha256: str | None) -> StoredPolicy:
        """The version that a machine says it has on board; the active one where it is not known here.

        Raises:
            ApiError: neither can be used, with the cause.
        """
        self.refresh()
        found = self._present.get(policy_sha256 or "")
        is_usable = (
            found is not None
            and found.card.mode is mode
            and found.card.model_sha256 == self._spec.sha256
        )
        return found if found is not None and is_usable else self.active(mode)

    def present(self) -> tuple[StoredPolicy, ...]:
        """Versions whose files are there."""
        self.refresh()
        return tuple(self._present.values())

    def find(self, policy_sha256: str) -> StoredPolicy | None:
        """A version whose files are there; None without."""
        self.refresh()
        return self._present.get(policy_sha256)

    def name_of(self, policy_sha256: str) -> str:
        """Id of a version; the start of its hash if its files are gone."""
        found = self._present.get(policy_sha256)
        return policy_sha256[:12] if found is None else found.card.policy_id

    def is_active(self, policy_sha256: str) -> bool:
        """Whether the server plans with a version where a machine does not say what it has."""
        self.refresh()
        return any(p.card.policy_sha256 == policy_sha256 for p in self._active.values())

    def active_folders(self) -> tuple[Path, ...]:
        """Folders of the active policies."""
        self.refresh()
        return tuple(policy.folder for policy in self._active.values())

    def _unusable(self, mode: Mode) -> ApiError:
        cause = self._problems.get(mode.value, "none is active")
        return from_reason(
            RejectReason.POLICY_UNUSABLE, f"No usable policy for mode {mode.value}: {cause}."
        )

    def usable(self, aboard: Mapping[str, str]) -> dict[Mode, StoredPolicy]:
        """The version that a machine throws with in each mode, by `on_machine`.

        Args:
            aboard: what the machine says it has on board, sha256 by mode; empty before it said so.
        """
        found: dict[Mode, StoredPolicy] = {}
        for mode in sorted(Mode):
            with contextlib.suppress(ApiError):
                found[mode] = self.on_machine(mode, aboard.get(mode.value))
        return found

    def reach(self, aboard: Mapping[str, str]) -> ReachView:
        """Where the versions on board of a machine reach (see `usable`)."""
        return ReachView(
            static_reach_m=self._spec.static_reach_m,
            modes=tuple(
                ModeReach(
                    mode=mode,
                    policy_id=policy.card.policy_id,
                    policy_sha256=policy.card.policy_sha256,
                    range_min_m=max(policy.card.target_range_min_m, MIN_RANGE_M[mode]),
                    range_max_m=policy.card.target_range_max_m,
                    raised_range_max_m=reach_m(policy.card, policy.card.target_height_max_m),
                    height_min_m=policy.card.target_height_min_m,
                    height_max_m=policy.card.target_height_max_m,
                    has_pace=PACE_NAME in policy.card.observation_names,
                )
                for mode, policy in self.usable(aboard).items()
            ),
        )

    def farthest_m(
        self, aboard: Mapping[str, str], modes: Collection[Mode], height_m: float
    ) -> float:
        """As far as any version on board reaches at a height in these modes; 0 where there is none."""
        cards = [policy.card for mode, policy in self.usable(aboard).items() if mode in modes]
        return max((reach_m(card, height_m) for card in cards), default=0.0)

    def views(self) -> list[PolicyView]:
        """All versions ever seen, the active ones first."""
        self.refresh()
        with self._database.read() as session:
            rows = session.scalars(select(Policy)).all()
            counted = session.execute(
                select(Throw.policy_sha256, func.count()).group_by(Throw.policy_sha256)
            )
            counts = {row[0]: row[1] for row in counted}
            found = states(session)
        views = [
            self._view(row, counts.get(row.policy_sha256, 0), found.get(row.policy_sha256))
            for row in rows
        ]
        return sorted(views, key=lambda v: (not v.is_active, not v.is_present, v.policy_id))

    def view(self, policy_sha256: str) -> PolicyView:
        """One version.

        Raises:
            NotFoundError: never seen.
        """
        self.refresh()
        with self._database.read() as session:
            row = session.get(Policy, policy_sha256)
            if row is None:
                raise NotFoundError("no_policy", f"No policy has sha256 {policy_sha256[:16]}...")
            count = session.scalar(select(func.count()).where(Throw.policy_sha256 == policy_sha256))
            state = state_of(session, policy_sha256)
        return self._view(row, count or 0, state)

    def _view(self, row: Policy, throw_count: int, state: PolicyState | None) -> PolicyView:
        mode = Mode(row.mode)
        active = self._active.get(mode)
        is_present = row.policy_sha256 in self._present
        return PolicyView(
            policy_id=row.policy_id,
            policy_sha256=row.policy_sha256,
            mode=mode,
            # Rows of before the life was kept have no step until their files are seen again.
            state=state or PolicyState.UPLOADED,
            is_active=active is not None and active.card.policy_sha256 == row.policy_sha256,
            is_present=is_present,
            problem=None if is_present else self._problems.get(row.policy_id, "its files are gone"),
            first_seen_utc=row.first_seen_utc,
            throw_count=throw_count,
            card=PolicyCard.model_validate(row.card),
        )


def _upload_record(folder: Path) -> UploadRecord:
    """Who brought the version in a folder."""
    try:
        return UploadRecord.model_validate_json((folder / UPLOAD_FILE).read_bytes())
    except (OSError, ValueError):
        return UploadRecord(uploaded_by=SERVER.name, reason=FOUND_REASON)
