"""Kills of server, control process, link process, machine and network during work on policy versions.

    python -m benchmarks.policy_kills [--count 50] [--seed 38] [--json FILE]

A step begins, and at a random time of its usual duration its victim is killed by SIGKILL (the network: all
connections cut for seconds) and started again. Then no version may be half there on server or machine, every
machine must have an approved version of each mode that loads, the step must have gone on or been refused with
a sentence, and what machines hold must be what the server's history says, at the end also at random times. A
machine's versions are noted by its control process itself (benchmarks/observed_machine.py).
"""

import bisect
import contextlib
import io
import itertools
import math
import os
import random
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx
import tyro

from benchmarks.observed_machine import ALIVE_PERIOD_S
from benchmarks.policy_yard import MACHINES, MODE, Machine, Yard
from benchmarks.result_file import RESULTS, Row, describe, percentile, row, write_result
from cli.service import rollback
from tests.waiting import until

SEED = 38
KILLS = {
    ("upload", "server"): 5,
    ("upload", "network"): 3,
    ("validation", "server"): 3,
    ("validation", "machine"): 1,
    ("transfer", "server"): 2,
    ("transfer", "control"): 2,
    ("transfer", "link"): 3,
    ("transfer", "machine"): 3,
    ("transfer", "network"): 2,
    ("switch", "server"): 2,
    ("switch", "control"): 4,
    ("switch", "link"): 4,
    ("switch", "machine"): 4,
    ("rollback", "server"): 2,
    ("rollback", "control"): 3,
    ("rollback", "link"): 3,
    ("rollback", "machine"): 3,
    ("rollback", "network"): 1,
}
"""Step and victim -> kills in a round of 50."""
TIMES_COUNT = 1000
LATE_RATIO = 1.1
"""Kills fall up to this share of a step's usual duration after its beginning."""
NEAR_S = 0.05
"""So close to a change either version is taken as right: both processes read the computer's clock."""
VERSION_COUNT = 4
FINISH_S = 240.0
VALIDATION_S = 60.0
"""Shorter than a validation lasts: it is always killed in the midst."""
SMALL = {"protocol": "short", "throws_per_target": 2, "unseen_unit_count": 0}


@dataclass
class Work:
    """A step that has begun."""

    is_done: Callable[[], Any]
    finish: Callable[[], str]
    """Waits for its end after everything runs again; "went on", "refused", or what is wrong."""
    machine: Machine | None = None
    client: httpx.Client | None = None


@dataclass
class Figures:
    """Of one step and victim."""

    outcomes: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)


class Kills:
    """One round."""

    def __init__(self, yard: Yard, rng: random.Random) -> None:
        self.yard, self.rng = yard, rng
        self.usual_s: dict[str, float] = {}
        self.figures: dict[tuple[str, str], Figures] = {}
        until(self._all_held, "both machines", 180.0)
        self.versions = [yard.make_version() for _ in range(VERSION_COUNT)]
        for version in self.versions:
            yard.upload(version).raise_for_status()
            yard.approve(version)
        self.validations: list[str] = []
        for machine in yard.machines:
            # A version before the one in use, so that both can go back.
            for _ in range(2):
                work = self.deploy(machine)
                until(work.is_done, "the first deployments", FINISH_S)
        self.usual_s["validation"] = VALIDATION_S
        for step in ("upload", "transfer", "switch", "rollback"):
            began_s = time.monotonic()
            work = self.begin(step)
            began_s = max(began_s, self._began_s)
            until(work.is_done, step, FINISH_S)
            self.usual_s[step] = time.monotonic() - began_s
            self._expect(work.finish())
        print("usual durations, s:", {k: round(v, 2) for k, v in self.usual_s.items()}, flush=True)

    def _expect(self, outcome: str) -> None:
        if outcome != "went on":
            raise RuntimeError(f"without a kill: {outcome}")

    def _all_held(self) -> bool:
        try:
            return all(self.yard.held(machine_id) for machine_id in MACHINES)
        except httpx.TransportError:
            return False

    # Steps ----------------------------------------------------------------------------------------

    def begin(self, step: str) -> Work:
        """Begin a step; `_began_s` is the time from which on it may be killed."""
        machine = self.rng.choice(self.yard.machines)
        if step == "rollback" and machine.slots.of(MODE).is_previous_rolled_back:
            # There is no way back from a version that a rollback brought.
            until(self.deploy(machine).is_done, "a version to go back from", FINISH_S)
        if step == "upload":
            work = self._upload()
        elif step == "validation":
            work = self._validate(machine)
        elif step == "rollback":
            work = self.roll_back(machine)
        else:
            work = self.deploy(machine)
            wanted = self._wanted
            place = machine.slots.incoming / wanted
            if step == "switch":
                place = machine.slots.version_folder(wanted)
            else:
                whole = machine.slots.version_folder(wanted)
                work.is_done = whole.exists
            until(lambda: place.exists() or work.is_done(), f"begin of {step}", FINISH_S)
        self._began_s = time.monotonic()
        return work

    def _upload(self) -> Work:
        yard = self.yard
        version = yard.make_version()
        client, codes = yard.far_client(), list[int]()

        def send() -> None:
            with contextlib.suppress(httpx.TransportError):
                codes.append(yard.upload(version, client).status_code)

        thread = threading.Thread(target=send, daemon=True)
        thread.start()

        def finish() -> str:
            thread.join(FINISH_S)
            present = [v["policy_sha256"] for v in yard.client.get("/policies").json()]
            if version in present:
                return "went on"
            if codes == [201]:
                return "an upload that was acknowledged is not there"
            again = yard.upload(version)
            return "refused" if again.status_code == 201 else f"sent again: {again.text[:200]}"

        return Work(lambda: not thread.is_alive(), finish)

    def _validate(self, machine: Machine) -> Work:
        client = self.yard.client
        # A version of its own each time: two validations may run at once.
        version = self.yard.make_version()
        self.yard.upload(version).raise_for_status()
        path = f"/policies/{version}/validation"
        client.post(path, json=SMALL).raise_for_status()
        self.validations.append(path)

        def is_known() -> Any:
            return client.get(path).json()["state"] in ("queued", "running", "done")

        def finish() -> str:
            until(is_known, "validation goes on", FINISH_S)
            return "went on"

        return Work(is_known, finish, machine)

    def end_of_validations(self) -> list[str]:
        """Wait for those that were killed; what is wrong with how they ended."""
        wrong: list[str] = []
        for path in self.validations:
            view = self.yard.client.get(path).json()
            end_s = time.monotonic() + 3 * FINISH_S
            while view["ended_utc"] is None and time.monotonic() < end_s:
                time.sleep(1.0)
                view = self.yard.client.get(path).json()
            print("validation:", view["state"], view["detail"], view["is_passed"], flush=True)
            if view["state"] != "done":
                wrong.append(f"a validation ended as {view['state']}: {view['detail']}")
        return wrong

    def deploy(self, machine: Machine) -> Work:
        """Ask for a version that the machine does not have on its disk."""
        slots = machine.slots.of(MODE)
        versions = machine.data / "policies" / "versions"
        aboard = {slots.current, slots.previous}
        aboard |= {path.name for path in versions.iterdir()} if versions.is_dir() else set()
        wanted = self._wanted = self.rng.choice([v for v in self.versions if v not in aboard])
        path = f"/machines/{machine.machine_id}/policies/2d/deploy"
        body = {"reason": "for the kills", "policy_sha256": wanted}
        self.yard.client.post(path, json=body).raise_for_status()
        return self._deployment(machine, wanted)

    def _deployment(self, machine: Machine, wanted: str) -> Work:
        yard, before = self.yard, machine.slots.of(MODE).current

        def ended() -> Any:
            newest = yard.client.get(f"/machines/{machine.machine_id}/deployments").json()[0]
            return newest if newest["outcome"] != "pending" else None

        def finish() -> str:
            newest = until(ended, f"deployment to {machine.machine_id}", FINISH_S)
            if newest["outcome"] == "switched":
                until(
                    lambda: yard.held(machine.machine_id) == wanted, "the version in use", FINISH_S
                )
                return "went on"
            if not newest["detail"]:
                return f"a deployment ended {newest['outcome']} without a sentence"
            held = machine.slots.of(MODE).current
            return "refused" if held == before else "refused, but another version is in use"

        return Work(lambda: machine.slots.of(MODE).current == wanted and ended(), finish, machine)

    def roll_back(self, machine: Machine) -> Work:
        """Back to the version before, asked at the server or at the machine."""
        target = machine.slots.previous(MODE)
        if self.rng.random() < 0.5:
            path = f"/machines/{machine.machine_id}/policies/2d/rollback"
            self.yard.client.post(path, json={"reason": "for the kills"}).raise_for_status()
            return self._deployment(machine, target)
        with contextlib.redirect_stdout(io.StringIO()):
            rollback.run(data=machine.data, mode="2d", timeout_s=0.0)

        def is_back() -> bool:
            return machine.slots.of(MODE).current == target

        def finish() -> str:
            until(is_back, f"rollback at {machine.machine_id}", FINISH_S)
            until(lambda: self.yard.held(machine.machine_id) == target, "the version in use", 60.0)
            return "went on"

        return Work(is_back, finish, machine)

    # Kills ----------------------------------------------------------------------------------------

    def run(self, step: str, victim: str) -> None:
        """One kill, and what must hold after it."""
        figures = self.figures.setdefault((step, victim), Figures())
        work = self.begin(step)
        machine = work.machine or self.rng.choice(self.yard.machines)
        moment_s = self.rng.uniform(0.0, LATE_RATIO * self.usual_s[step])
        time.sleep(max(self._began_s + moment_s - time.monotonic(), 0.0))
        began_s = time.monotonic()
        self._kill(victim, machine)
        try:
            until(self._all_held, "machines are connected again", FINISH_S)
            outcome = work.finish()
        except TimeoutError as error:
            outcome = str(error)
        figures.seconds.append(time.monotonic() - began_s)
        figures.outcomes.append(outcome)
        found = [] if outcome in ("went on", "refused") else [outcome]
        found += self.yard.stored_problems()
        for one in self.yard.machines:
            found += one.problems()
            with contextlib.suppress(TimeoutError):
                until(lambda one=one: self._is_in_history(one), "history", 30.0)
                continue
            found.append(f"{one.machine_id}: the history is not what the machine holds")
        figures.problems += found
        print(f"{step:<11}{victim:<9}{moment_s:6.2f} s  {outcome}  {found or ''}", flush=True)

    def _kill(self, victim: str, machine: Machine) -> None:
        yard = self.yard
        if victim == "server":
            assert yard.server is not None
            yard.server.kill()
            yard.start_server()
        elif victim == "machine":
            assert machine.group is not None
            machine.group.kill()
            machine.start()
        elif victim == "network":
            for relay in (yard.http_relay, yard.link_relay):
                relay.cut()
            time.sleep(self.rng.uniform(2.0, 5.0))
            for relay in (yard.http_relay, yard.link_relay):
                relay.mend()
        else:
            machine.kill_child(victim)

    def _is_in_history(self, machine: Machine) -> bool:
        view = self.yard.client.get(f"/machines/{machine.machine_id}/policies").json()
        shown = {one["mode"]: one["policy_sha256"] for one in view["policies"]}
        return shown == machine.log()[-1]["held"]

    # History --------------------------------------------------------------------------------------

    def history(self, begin_s: float) -> list[str]:
        """Compare the server's history with the machines' own notes at random times since `begin_s`."""
        wrong: list[str] = []
        rows = {machine.machine_id: machine.log() for machine in self.yard.machines}
        logs = {machine.machine_id: changes_of(machine.log()) for machine in self.yard.machines}
        for _ in range(TIMES_COUNT):
            machine_id = self.rng.choice(MACHINES)
            times, held = logs[machine_id]
            t_s = self.rng.uniform(begin_s, time.time())
            after = bisect.bisect_right(times, t_s)
            if is_off(rows[machine_id], t_s):
                continue
            near_s = min(abs(t_s - times[k]) for k in (after - 1, after) if 0 <= k < len(times))
            at = datetime.fromtimestamp(t_s, UTC).isoformat()
            view = self.yard.client.get(f"/machines/{machine_id}/policies", params={"at": at})
            shown = {one["mode"]: one["policy_sha256"] for one in view.json()["policies"]}
            if near_s > NEAR_S and shown != held[after - 1]:
                wrong.append(f"{machine_id} at {at}, {near_s:.2f} s from a change")
        return wrong


def is_off(log: list[dict[str, Any]], t_s: float) -> bool:
    """Whether no control process wrote into a machine's log around a time: it held nothing then."""
    after = bisect.bisect_right([line["t_s"] for line in log], t_s)
    last, following = log[after - 1], log[after] if after < len(log) else None
    is_other_boot = following is not None and following["boot_id"] != last["boot_id"]
    return is_other_boot and t_s - last["t_s"] > ALIVE_PERIOD_S


def changes_of(log: list[dict[str, Any]]) -> tuple[list[float], list[dict[str, str]]]:
    """Times at which a machine began to hold other versions, s, and those versions."""
    times: list[float] = []
    held: list[dict[str, str]] = []
    for line in log:
        if not held or line["held"] != held[-1]:
            times.append(line["t_s"])
            held.append(line["held"])
    return times, held


def plan(count: int, rng: random.Random) -> list[tuple[str, str]]:
    """Steps and victims of so many kills."""
    one_round = [pair for pair, kills in KILLS.items() for _ in range(kills)]
    rng.shuffle(one_round)
    return list(itertools.islice(itertools.cycle(one_round), count))


def rows_of(kills: Kills, wrong: list[str]) -> list[Row]:
    """A row a step and victim, and one for the history."""
    rows = [
        row(
            len(found.outcomes),
            {"step": step, "victim": victim},
            {
                "violations": len(found.problems),
                "went_on": found.outcomes.count("went on"),
                "refused": found.outcomes.count("refused"),
                "done_after_s": percentile(found.seconds, 50).value,
            },
        )
        for (step, victim), found in sorted(kills.figures.items())
    ]
    nothing = {"went_on": None, "refused": None, "done_after_s": None}
    history = {"step": "history", "victim": "at random times"}
    return [*rows, row(TIMES_COUNT, history, {"violations": len(wrong), **nothing})]


def main(
    count: int = 50,
    seed: int = SEED,
    json: Path = RESULTS / "policy_kills.json",
    scratch: str = "",
    minutes: float = math.inf,
) -> None:
    """Kill `count` times, or as often as `minutes` allow; `scratch`: folder for the temporary one."""
    # Ended from outside, it ends what it started.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    rng = random.Random(seed)
    with tempfile.TemporaryDirectory(dir=scratch or None) as name:
        yard = Yard(Path(name), rng)
        try:
            kills = Kills(yard, rng)
            begin_s = time.time()
            for number, (step, victim) in enumerate(plan(count, rng), 1):
                if time.time() - begin_s > 60.0 * minutes:
                    break
                print(f"{number:>3} ", end="")
                kills.run(step, victim)
            wrong = kills.history(begin_s)
            late = kills.end_of_validations()
        finally:
            yard.close()
    for line in wrong[:20]:
        print("history:", line)
    for (step, _), found in kills.figures.items():
        if step == "validation":
            found.problems += late
            break
    problems = [text for found in kills.figures.values() for text in found.problems]
    done = sum(len(found.outcomes) for found in kills.figures.values())
    title = "Kills during work on policy versions"
    notes = (
        f"{done} kills, {len(problems)} violations. Within {NEAR_S:.2f} s of a change either version "
        f"counts as right. Load of the host: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores."
    )
    write_result(
        describe("policy_kills", title, rows_of(kills, wrong), seed=seed, notes=notes), json
    )


if __name__ == "__main__":
    tyro.cli(main)
