"""Runs learned policies with onnxruntime, one thread, and refuses files that do not fit this machine.

It never trains, downloads or repairs a policy; a file that is not exactly what its card says is an error.
"""

import json
import re
import time
from pathlib import Path

import numpy as np
import onnxruntime as ort

from machine.conventions import CONTROL_PERIOD_S, POLICY_PERIOD_S, Array, Mode
from machine.errors import PolicyError
from machine.golden_vectors import read_golden_vectors
from machine.policy_card import POLICY_FILE, PolicyCard, PolicyFiles, read_policy
from machine.spec import MachineSpec
from runtime.control.observation import ACTION_NAMES, PACE_NAME, observation_names
from runtime.control.policy_file import check_policy_file

POLICY_ID = re.compile(r"[a-z0-9][a-z0-9._-]{2,63}")
"""As in the card (machine.policy_card.PolicyCard)."""
ACTIVE_FILE = "active.json"
MAX_RUN_S = 0.02
"""Longest run of a policy that is accepted when it is loaded; a shipped one takes 0.05 ms."""
LATE_PROCESSOR_S = 0.01
LATE_WALL_S = 0.1
"""A run of longer than a control tick of processor time, or than ten ticks on a busy computer, is late."""
INPUT_NAME = "observation"
OUTPUT_NAME = "action"


def find_policy(policies_dir: Path, mode: Mode) -> Path:
    """Folder of the active policy of a mode: `active.json` = {"2d": "<id>", "3d": "<id>"}.

    Raises:
        PolicyError: no readable active.json, no entry for the mode, or its folder is missing.
    """
    path = policies_dir / ACTIVE_FILE
    try:
        active = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise PolicyError(
            f'{path} cannot be read ({error}); it names the active policies: {{"2d": "<id>", "3d": "<id>"}}'
        ) from error
    policy_id = active.get(mode.value) if isinstance(active, dict) else None
    if not isinstance(policy_id, str):
        raise PolicyError(
            f"{path} names no policy for mode {mode.value}; add one of the folders beside it"
        )
    folder = policies_dir / policy_id
    # An id is a name, never a path out of the folder.
    if not POLICY_ID.fullmatch(policy_id) or not folder.is_dir():
        raise PolicyError(
            f"{path} names policy {policy_id!r} for mode {mode.value}, but {folder} is no policy folder"
        )
    return folder


class PolicyRunner:
    """One loaded policy. Thread-compatible, not shared between threads."""

    def __init__(
        self, version: Path | PolicyFiles, spec: MachineSpec, *, has_deadline: bool = False
    ) -> None:
        """Load, check against card, machine and golden vectors, and warm up.

        Args:
            version: folder of the policy, or its files that were read and checked already.
            spec: machine type.
            has_deadline: whether runs may be late; a machine's may, a simulation's take what they take.

        Raises:
            PolicyError: with what differs, and what to do.
        """
        files = version if isinstance(version, PolicyFiles) else read_policy(version)
        folder = files.folder
        self.card: PolicyCard = files.card
        _check_card(self.card, folder, spec)
        self._session = _open_session(files.policy, folder / POLICY_FILE)
        self._observation_count = len(self.card.observation_names)
        self._action_count = len(self.card.action_names)
        self.is_paced = is_paced(self.card)
        """Whether it sees the pace."""
        _check_signature(
            self._session, folder / POLICY_FILE, self._observation_count, self._action_count
        )
        self._has_deadline = has_deadline
        self.is_late = False
        """Whether the last run took too long for its tick."""
        self.action_scale_rad_m_per_s: Array = np.asarray(self.card.action_scale_rad_m_per_s)
        # The first runs allocate; and a file that cannot run must fail here, not in a throw.
        seconds: list[float] = []
        for count in (1, 2, 1, 1):
            began_s = time.perf_counter()
            self.act(np.zeros((count, self._observation_count)))
            seconds.append(time.perf_counter() - began_s)
        if files.golden is not None:
            golden = read_golden_vectors(files.golden, str(folder))
            golden.check(self.infer, self.card.action_names, f"policy {self.card.policy_id}")
        if min(seconds) > MAX_RUN_S:
            raise PolicyError(
                f"policy {self.card.policy_id} takes {min(seconds) * 1e3:.0f} ms a run, at most "
                f"{MAX_RUN_S * 1e3:.0f} ms are taken; use a smaller network"
            )

    def infer(self, observation: Array) -> Array:
        """Raw actions (N, A) for observations (N, D); may hold NaN, never raises for values.

        Raises:
            PolicyError: another shape comes in or out, or the network cannot run.
        """
        given = np.ascontiguousarray(observation, dtype=np.float32)
        if given.ndim != 2 or given.shape[1] != self._observation_count:
            raise PolicyError(
                f"policy {self.card.policy_id} got observations of shape {given.shape}, "
                f"needs (N, {self._observation_count})"
            )
        began_s, busy_s = time.perf_counter(), time.thread_time()
        try:
            result = self._session.run([OUTPUT_NAME], {INPUT_NAME: given})[0]
        except Exception as error:  # onnxruntime raises bare exceptions of its own C++ types
            raise PolicyError(f"policy {self.card.policy_id} failed to run ({error})") from error
        busy_s, took_s = time.thread_time() - busy_s, time.perf_counter() - began_s
        self.is_late = self._has_deadline and (busy_s > LATE_PROCESSOR_S or took_s > LATE_WALL_S)
        action = np.asarray(result, dtype=np.float64)
        expected_shape = (given.shape[0], self._action_count)
        if action.shape != expected_shape:
            raise PolicyError(
                f"policy {self.card.policy_id} gave actions of shape {action.shape} for observations "
                f"of shape {given.shape}, needs {expected_shape}; export the policy again"
            )
        return action

    def act(self, observation: Array) -> Array:
        """Actions (N, A) for observations (N, D), as the policy gives them (not clipped).

        Raises:
            PolicyError: wrong width, or an action that is not finite.
        """
        action = self.infer(observation)
        finite = np.isfinite(action)
        if not finite.all():
            row, column = (int(i) for i in np.argwhere(~finite)[0])
            raise PolicyError(
                f"policy {self.card.policy_id} gave {self.card.action_names[column]} = "
                f"{action[row, column]} for row {row} of {action.shape[0]}; use another policy version"
            )
        return action


def _open_session(content: bytes, path: Path) -> ort.InferenceSession:
    check_policy_file(content, str(path))
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    # A spinning worker would take the core that the link process needs.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.add_session_config_entry("session.inter_op.allow_spinning", "0")
    # Never the other format, whose networks are not checked here.
    options.add_session_config_entry("session.load_model_format", "ONNX")
    options.log_severity_level = 4
    try:
        # From the bytes that were checked: without a path nothing beside the file can be read.
        return ort.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime raises bare exceptions of its own C++ types
        raise PolicyError(f"{path} is not a usable ONNX file ({error}); copy it again") from error


def is_paced(card: PolicyCard) -> bool:
    """Whether a policy sees the pace."""
    return card.observation_names[-1:] == (PACE_NAME,)


def _check_card(card: PolicyCard, folder: Path, spec: MachineSpec) -> None:
    if card.model_sha256 != spec.sha256:
        raise PolicyError(
            f"{folder} was trained for model {card.model_sha256[:12]}..., this machine is "
            f"{spec.sha256[:12]}... ({spec.model_name}); use a policy trained for it"
        )
    for what, given, expected in (
        (
            "observations",
            card.observation_names,
            observation_names(card.mode, is_paced(card)),
        ),
        ("actions", card.action_names, ACTION_NAMES[card.mode]),
    ):
        if tuple(given) != expected:
            raise PolicyError(
                f"{folder}: the card names {len(given)} {what}, this runtime gives {len(expected)} "
                f"in {card.mode.value} (first difference: {_first_difference(given, expected)}); "
                "export the policy again"
            )
    rates_hz = (card.policy_rate_hz, card.control_rate_hz)
    if rates_hz != (1.0 / POLICY_PERIOD_S, 1.0 / CONTROL_PERIOD_S):
        raise PolicyError(
            f"{folder} is for a policy rate of {rates_hz[0]:g} Hz and a control rate of "
            f"{rates_hz[1]:g} Hz, this runtime gives {1.0 / POLICY_PERIOD_S:g} and "
            f"{1.0 / CONTROL_PERIOD_S:g}; use a policy trained for them"
        )
    scale = np.asarray(card.action_scale_rad_m_per_s)
    expected_count = len(card.action_names) - 1
    if scale.shape != (expected_count,) or not np.all(np.isfinite(scale) & (scale > 0.0)):
        raise PolicyError(
            f"{folder}: action_scale_rad_m_per_s must be {expected_count} positive numbers, "
            f"is {list(card.action_scale_rad_m_per_s)}; export the policy again"
        )


def _first_difference(given: tuple[str, ...], expected: tuple[str, ...]) -> str:
    for index, (one, other) in enumerate(zip(given, expected, strict=False)):
        if one != other:
            return f"number {index} is {one!r}, should be {other!r}"
    return f"{len(given)} names, should be {len(expected)}"


def _check_signature(
    session: ort.InferenceSession, path: Path, observation_count: int, action_count: int
) -> None:
    for what, nodes, name, width in (
        ("input", session.get_inputs(), INPUT_NAME, observation_count),
        ("output", session.get_outputs(), OUTPUT_NAME, action_count),
    ):
        found = [(node.name, node.type, list(node.shape)) for node in nodes]
        fits = (
            len(found) == 1
            and found[0][:2] == (name, "tensor(float)")
            and len(found[0][2]) == 2
            and found[0][2][1] == width
            and not isinstance(found[0][2][0], int)
        )
        if not fits:
            raise PolicyError(
                f"{path}: {what} is {found}, expected one float tensor {name!r} of shape "
                f"[batch, {width}] with a free batch; export the policy again"
            )
