"""Twin with oil springs against twin with linear drives, on throws of the plant `ring` of other days.

    python -m benchmarks.drives [--units 3 4] [--days 5 6] [--throws 12]

A machine is measured on day 1: valve tables, linear responses, oil springs. Its throws of other days are then
replayed from their valve commands, and previewed from target and start pose, with both twins.
"""

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.plants.ring.plant import Ring
from benchmarks.result_file import Row, Value, describe, row, write_result
from diagnosis.loading.logs import load_throws
from diagnosis.loading.prepared import PreparedThrow, prepare
from machine.calibration import ValveCalibration
from machine.conventions import ACTIVE_JOINTS, CONTROL_PERIOD_S, Array, Mode
from machine.spec import load_spec
from machine.starts import sample_starts
from runtime.control.control_loop import ControlParams
from runtime.control.policy import PolicyRunner, find_policy
from sim_twin.commissioning.drive_identification import identify_drives, with_drives
from sim_twin.commissioning.drive_motion import DRIVE_COPY_COUNT, record_drives
from sim_twin.commissioning.excitation import RESPONSE_COPY_COUNT, identify_profile
from sim_twin.commissioning.valve_calibration import CALIBRATION_STEP_COUNT, calibrate
from sim_twin.replay.replay import replay
from sim_twin.replay.types import ReplayElement
from sim_twin.throws.campaign import run_throws
from sim_twin.throws.throw_logs import CampaignRecorder, LogContext
from sim_twin.twin.profile import TwinProfile, exact_profile
from sim_twin.twin.twin import Twin

RANGES_M = (7.5, 10.0)
SPEC = load_spec()


class Throws:
    """Throws of one mode on one day, and what the machine's landings were."""

    def __init__(
        self, unit: int, day: int, mode: Mode, tables: ValveCalibration, count: int
    ) -> None:
        self.params = ControlParams(
            SPEC, tables, mode, PolicyRunner(find_policy(Path("policies"), mode), SPEC)
        )
        self.target_m = np.zeros((count, 3))
        self.target_m[:, 0] = np.linspace(*RANGES_M, count)
        rng = np.random.default_rng((unit, day))
        self.starts = sample_starts(SPEC, mode, self.target_m, rng)
        plant = Ring(count=count, unit_seed=unit, day_seed=day)
        with tempfile.TemporaryDirectory() as folder:
            context = LogContext("ring", f"ring-{mode.value}", 0, Path(folder))
            recorder = CampaignRecorder(self.params, context)
            results = run_throws(
                plant, self.params, self.target_m, self.starts, day, record=recorder
            )
            self.loaded = load_throws([Path(folder)])
        self.impact_m = np.array([r.impact_m for r in results])

    def previewed_m(self, profile: TwinProfile) -> Array:
        """Landings (N, 3) that the twin predicts from targets and starts."""
        twin = Twin(
            count=len(self.target_m),
            profile=exact_profile(profile),
            calibration=self.params.calibration,
        )
        results = run_throws(twin, self.params, self.target_m, self.starts, 0)
        return np.array([r.impact_m for r in results])


def replayed(
    prepared: Sequence[PreparedThrow], profile: TwinProfile, tables: ValveCalibration
) -> Any:
    """Errors of a replay: speeds by joint [(n, 4)] up to the opening, and landings (N,), m."""
    inputs = [p.input for p in prepared]
    found = replay(inputs, [ReplayElement(i) for i in range(len(inputs))], profile, tables)
    speeds: list[Array] = []
    for i, p in enumerate(prepared):
        until = round(p.input.release_t_s / CONTROL_PERIOD_S)
        measured = p.input.velocity_rad_m_per_s[:until]
        speeds.append(found.joint_velocity_rad_m_per_s[i, :until] - measured)
    landed = np.array([p.throw.impact_m for p in prepared])
    return np.concatenate(speeds), np.hypot(*(found.impact_m - landed).T[:2])


def rms(values: Array) -> float:
    """Root mean square of the finite values."""
    return float(np.sqrt(np.nanmean(np.square(values))))


def measure(units: Sequence[int], days: Sequence[int], count: int) -> list[Row]:
    """Rows by unit and twin."""
    rows: list[Row] = []
    for unit in units:
        tables = calibrate(
            Ring(count=CALIBRATION_STEP_COUNT, unit_seed=unit, day_seed=1), SPEC, "ring"
        )
        machine = Ring(count=RESPONSE_COPY_COUNT, unit_seed=unit, day_seed=1)
        linear, fits = identify_profile(machine, SPEC, tables, "ring")
        machine = Ring(count=DRIVE_COPY_COUNT, unit_seed=unit, day_seed=1)
        springs = with_drives(
            linear, identify_drives(record_drives(machine, SPEC, tables, 0), fits)
        )
        sets = [
            Throws(unit, day, mode, tables, count - count // 2) for day in days for mode in Mode
        ]
        for name, profile in (("linear", linear), ("oil springs", springs)):
            pairs = [replayed(prepare(s.loaded.throws, profile), profile, tables) for s in sets]
            speed = np.concatenate([speeds for speeds, _ in pairs])
            landing = np.concatenate([miss for _, miss in pairs])
            missed = [np.hypot(*(s.previewed_m(profile) - s.impact_m).T[:2]) for s in sets]
            values = {
                f"{joint}_rms_rad_m_per_s": Value(value=rms(speed[:, j]))
                for j, joint in enumerate(ACTIVE_JOINTS)
            }
            values["replayed_landing_rms_m"] = Value(value=rms(landing))
            values["previewed_landing_rms_m"] = Value(value=rms(np.concatenate(missed)))
            rows.append(row(landing.size, {"unit": str(unit), "drives": name}, values))
            print(
                rows[-1].labels,
                {k: round(v.value or 0.0, 4) for k, v in values.items()},
                flush=True,
            )
    return rows


def main() -> None:
    """Measure and write the result file."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--units", type=int, nargs="+", default=[3, 4])
    parser.add_argument("--days", type=int, nargs="+", default=[5, 6])
    parser.add_argument("--throws", type=int, default=12, help="a day, half of them in each mode")
    parser.add_argument(
        "--json", type=Path, help="result file (default: benchmarks/results/drives.json)"
    )
    options = parser.parse_args()
    rows = measure(options.units, options.days, options.throws)
    notes = "Plant `ring`, measured on day 1, thrown on other days."
    write_result(
        describe(
            "drives", "Twins with linear drives and with oil springs", rows, seed=0, notes=notes
        ),
        options.json,
    )


if __name__ == "__main__":
    main()
