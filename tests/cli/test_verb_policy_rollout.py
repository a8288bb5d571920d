"""`policy rollout` ends with 0 where the rollout is as the action wants it, else with 3."""

from types import TracebackType
from typing import Any, cast

from cli.service.policy_rollout import rollout
from cli.service.throw_client import Login
from tests.cases import each


class _Server:
    """Has one open rollout; every change leads to one state."""

    def __init__(self, state: str) -> None:
        self._after = state

    def open(self, _user: str) -> "_Server":
        return self

    def __enter__(self) -> "_Server":
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        pass

    def call(self, method: str, path: str, body: dict[str, Any] | None = None) -> Any:
        is_change = method == "POST"
        state = self._after if is_change or self._after == "paused" else "running"
        found = {
            "rollout_id": "r1", "mode": "2d", "policy_id": "v8", "stage_count": 0, "machines": [],
            "stages": ["m001"], "state": state,
            "steps": [{"at_utc": "", "state": state, "actor": "eve", "sentence": "why"}],
        }  # fmt: skip
        return found if is_change else [found]


@each(
    "action,state,code",
    [
        ("pause", "paused", 0),
        ("pause", "running", 3),
        ("abort", "aborted", 0),
        ("resume", "running", 0),
        ("resume", "paused", 3),
        ("promote", "completed", 0),
        ("status", "running", 0),
        ("status", "paused", 3),
    ],
)
def test_the_exit_code_says_whether_it_is_as_asked(action: Any, state: str, code: int) -> None:
    assert rollout(action, reason="a reason", login=cast(Login, _Server(state))) == code
