"""From a planted dead time to its name: the drift test's alarm, and the diagnosis that it opens.

    python -m benchmarks.drift_diagnosis [--extra-s 0.15] [--json FILE]

A virtual machine throws as it was measured, then with a dipper valve that is late and 2 % of nuisance in
every parameter. Its misses go through the drift test, throw by throw as the server takes them; with the
throws that have come up to where a diagnosis begins by itself, it is asked what the server would ask.
"""

import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import tyro

from benchmarks.result_file import RESULTS, Row, describe, row, write_result
from challenge.make import make_reference, make_set
from challenge.sealed_truth import SetTruth, Tier, TrueEffect
from diagnosis.loading.logs import load_throws
from diagnosis.loading.throw_data import ThrowData
from diagnosis.report.diagnosis_words import words_of
from machine.conventions import Mode
from machine.messages import Target
from server.drift.drift_diagnosis import DIAGNOSED_COUNT, drift_request
from server.drift.drift_test import Drift, DriftTest, ThrowMiss
from server.drift.found_drift import FoundDrift, TestedThrow
from server.gap.gap_worker import GapJob, diagnose_logs
from server.plans.landing_errors import errors_of
from sim_twin.twin.profile import TwinProfile

HEALTHY_COUNT = 240
LATE_COUNT = 120
"""Throws in all; the modes take turns."""
POLICIES = Path("policies")
SEED = 11
EFFECT, JOINT = "valve_dead_time", "dipper"
SPREAD_M = 0.1
"""Predicted spread of every throw; the drift test weighs misses by it."""


def tested(throws: tuple[ThrowData, ...], mode: Mode) -> list[TestedThrow]:
    """Throws of a mode as the server would have them, aimed at their targets, in their order."""
    found: list[TestedThrow] = []
    for throw in throws:
        if throw.mode == mode.value and np.isfinite(throw.impact_m).all():
            x_m, y_m, z_m = (float(value) for value in throw.target_m)
            errors = errors_of(
                Target(x_m=x_m, y_m=y_m, z_m=z_m),
                float(throw.impact_m[0]),
                float(throw.impact_m[1]),
            )
            miss = ThrowMiss(errors[0] / SPREAD_M, errors[1] / SPREAD_M, *errors)
            found.append(TestedThrow(throw.throw_id, True, miss))
    return found


def found_drift(throws: list[TestedThrow], mode: Mode) -> tuple[FoundDrift, Drift] | None:
    """The drift with the throws up to where its diagnosis begins by itself."""
    test = DriftTest()
    for count, throw in enumerate(throws, start=1):
        drift = test.add(throw.miss)
        if drift is not None and count - drift.change_count >= DIAGNOSED_COUNT:
            seen, first = throws[:count], drift.change_count
            found = FoundDrift(mode, drift.change, tuple(seen[:first]), tuple(seen[first:]))
            return found, drift
    return None


def diagnosed(
    drift: FoundDrift, paths: Mapping[str, Path], profile: TwinProfile, alarm: Mapping[str, float]
) -> Row:
    """Carry out the alarm's diagnosis: what it names, beside the numbers of the alarm."""
    request = drift_request(drift)
    began_s = time.monotonic()
    job = GapJob(
        "drift",
        tuple(paths[throw_id] for throw_id in request.throw_ids or ()),
        profile,
        tuple(paths[throw_id] for throw_id in request.reference_throw_ids or ()),
    )
    diagnosis = diagnose_logs(job, lambda share, text: None)
    cause = diagnosis.causes[0]
    print(diagnosis.verdict, words_of(diagnosis).causes[0])
    found = [part for part in cause.effects if (part.effect, part.joint) == (EFFECT, JOINT)]
    labels = {"mode": drift.mode.value, "planted": f"{EFFECT} {JOINT}", "named": cause.name}
    values = {
        "reference_count": len(job.reference_paths),
        "is_named_ratio": float(bool(found)),
        "found_s": found[0].parameters["extra_dead_time_s"].value if found else None,
        "diagnosis_s": time.monotonic() - began_s,
    }
    return row(len(job.log_paths), labels, {**alarm, **values})


def main(extra_s: float = 0.15, json: Path = RESULTS / "drift_diagnosis.json") -> None:
    """Measure and write the result.

    Args:
        extra_s: dead time that is planted.
        json: where the result is written.
    """
    effect = TrueEffect(
        effect=EFFECT,
        joint=JOINT,
        parameters={"extra_dead_time_s": extra_s},
        stage="actuation",
        multiple_ratio=4.0,
    )
    truth = SetTruth(set_id="late", tier=Tier.SINGLE, unit_seed=0, seed=SEED, effects=(effect,))
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        healthy = make_reference(0, SEED, folder, HEALTHY_COUNT, POLICIES)
        make_set(truth, folder, LATE_COUNT, POLICIES)
        print(f"thrown after {time.process_time():.0f} s of CPU")
        before, since = (load_throws([one]).throws for one in (healthy, folder / truth.set_id))
        profile = before[0].twin_profile
        assert profile is not None
        paths = {throw.throw_id: throw.path for throw in (*before, *since)}
        for mode in Mode:
            healthy_throws, late_throws = tested(before, mode), tested(since, mode)
            for throws in (healthy_throws, late_throws):
                along_m = [throw.miss.along_m for throw in throws]
                print(f"{mode.value}: {np.mean(along_m):+.3f} m along, sd {np.std(along_m):.3f} m")
            found = found_drift([*healthy_throws, *late_throws], mode)
            if found is None:
                print(f"{mode.value}: no drift was found")
                continue
            drift, alarm = found
            numbers = {
                "alarm_throws_count": alarm.alarm_count - len(healthy_throws),
                "change_point_late_count": alarm.change_count - len(healthy_throws),
                "planted_s": extra_s,
            }
            rows.append(diagnosed(drift, paths, profile, numbers))
    result = describe(
        "drift_diagnosis",
        "From a planted dead time over the drift's alarm to its name",
        rows,
        seed=SEED,
        notes="predicted: the target",
    )
    print(write_result(result, json), f"{time.process_time():.0f} s of CPU")


if __name__ == "__main__":
    tyro.cli(main)
