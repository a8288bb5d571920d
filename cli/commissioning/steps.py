"""The steps of a commissioning, each of which writes what it found before the next begins."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cli.commissioning.page import commissioning_html
from cli.machine_folder import MachineFolder
from diagnosis.identification.commissioning_record import (
    STEPS,
    Commissioning,
    RegistrationFit,
    StepName,
    joint_fit,
    load_record,
)
from diagnosis.identification.free_swing import identify_swing
from diagnosis.identification.profile_update import next_profile, with_release, with_swing
from diagnosis.identification.release_delay import identify_release
from diagnosis.loading.logs import load_throws
from diagnosis.loading.throw_data import LoadedSet
from evaluation.campaigns import Campaign, open_campaign
from evaluation.log_campaign import RecordedMachine, record_campaign
from machine.calibration import ValveCalibration, load_calibration
from machine.conventions import Mode
from machine.errors import UsageError
from machine.spec import load_spec
from sim_twin.commissioning.machine_measurement import (
    identify_machine,
    plot_valves,
    register_policies,
)
from sim_twin.commissioning.motions import TestKind
from sim_twin.commissioning.valve_calibration import CALIBRATION_STEP_COUNT, calibrate
from sim_twin.throws.plants import plant_maker
from sim_twin.twin.profile import TwinProfile, load_profile, save_profile

TARGETS = "7.5:10:0.5"
"""Ranges of reference throws: most of the reach of both modes."""


@dataclass(frozen=True)
class CommissioningJob:
    """What is commissioned, and where it is kept."""

    plant: str
    unit_seed: int
    files: MachineFolder
    seed: int
    policies: Path
    show: Callable[[str], None]

    def make(self, count: int) -> Any:
        """Copies of the machine."""
        made = plant_maker(
            self.plant, unit_seed=self.unit_seed, profile=None, calibration=None, spec=load_spec()
        )
        return made(count)

    @property
    def record_path(self) -> Path:
        """File that the commissioning goes on from."""
        return self.files.file("commissioning.json")

    def commission(self, reference_throws: int, day: str, *, again: bool) -> Commissioning:
        """Do every step that is not done, then throw reference throws on this day.

        Args:
            reference_throws: number that this day should have.
            day: name of the day, YYYY-MM-DD.
            again: measure everything anew; reference throws are kept.

        Raises:
            UsageError: a step that cannot be done, with its reason; what was done before is kept.
        """
        self.files.folder.mkdir(parents=True, exist_ok=True)
        found = load_record(self.record_path, self.files.machine_id)
        if again:
            kept = {"reference": found.steps["reference"]} if "reference" in found.steps else {}
            found = found.model_copy(update={"steps": kept})
        work: dict[StepName, Callable[[Commissioning], Commissioning]] = {
            "valves": self._valves,
            "response": self._response,
            "release": self._release,
            "swing": self._swing,
            "registration": self._registration,
        }
        for number, (name, step) in enumerate(work.items(), 1):
            words = f"step {number} of {len(STEPS)}, {STEPS[name]}"
            if name in found.steps:
                self.show(f"{words}: done {found.steps[name].done_utc}")
                continue
            self.show(f"{words} ...")
            found = self._keep(step(found))
        self.show(f"step {len(STEPS)} of {len(STEPS)}, {STEPS['reference']} ...")
        return self._keep(self._reference(found, reference_throws, day))

    def _keep(self, found: Commissioning) -> Commissioning:
        """Write the record and the report."""
        text = found.model_dump_json(indent=1) + "\n"
        part = self.record_path.with_suffix(".part")
        part.write_text(text, encoding="utf-8")
        part.replace(self.record_path)
        html = commissioning_html(found)
        self.files.file("commissioning.html").write_text(html, encoding="utf-8")
        return found

    def _tables(self) -> ValveCalibration:
        return load_calibration(self.files.calibration)

    def _save_tables(self, tables: ValveCalibration) -> None:
        text = tables.model_dump_json(indent=2) + "\n"
        self.files.calibration.write_text(text, encoding="utf-8")

    def _valves(self, found: Commissioning) -> Commissioning:
        machine = self.make(CALIBRATION_STEP_COUNT)
        try:
            self._save_tables(calibrate(machine, load_spec(), self.files.machine_id, self.seed))
        finally:
            machine.close()
        return found.done("valves", f"{CALIBRATION_STEP_COUNT} valve steps")

    def _response(self, found: Commissioning) -> Commissioning:
        measured = identify_machine(
            self.make, self._tables(), self.files.machine_id, self.seed, self.show, has_drives=True
        )
        save_profile(measured.profile, self.files.profile)
        plot_valves(self.files.file("valves.png"), measured, self.files.machine_id)
        joints = tuple(joint_fit(one) for one in measured.drives)
        named = [fit.joint for fit in joints if fit.is_oil_spring]
        words = f"oil springs of {', '.join(named)}" if named else "linear drives"
        return found.done("response", words, joints=joints)

    def _release(self, found: Commissioning) -> Commissioning:
        loaded = self._test("release")
        release = identify_release(loaded.throws, load_spec())
        self._apply(with_release(release), loaded, "release delay")
        return found.done("release", f"{len(loaded.throws)} openings", release=release)

    def _swing(self, found: Commissioning) -> Commissioning:
        loaded = self._test("swing")
        profile, spec = load_profile(self.files.profile), load_spec()
        axes = identify_swing(loaded.throws, spec)
        self._apply(with_swing(profile, axes, spec), loaded, "swing")
        return found.done("swing", f"{len(loaded.throws)} swings", swing=axes)

    def _registration(self, found: Commissioning) -> Commissioning:
        profile = load_profile(self.files.profile)
        tables = self._tables().without_registrations()
        tables = register_policies(self.make, profile, tables, self.policies, self.seed, self.show)
        self._save_tables(tables)
        fits = tuple(
            RegistrationFit(
                mode=mode.value,
                throw_count=one.throw_count,
                largest_correction_m=float(np.abs([*one.downrange_m, *one.crossrange_m]).max()),
            )
            for mode, one in zip(Mode, tables.registrations, strict=True)
        )
        count = sum(fit.throw_count for fit in fits)
        return found.done("registration", f"{count} throws that landed", registrations=fits)

    def _reference(self, found: Commissioning, throws: int, day: str) -> Commissioning:
        days = self.files.reference.days()
        missing = throws - days.get(day, 0)
        if missing > 0:
            seed = abs(hash_of(day) + self.seed + days.get(day, 0))
            self._record(None, missing, seed, self.files.reference.folder / day)
        days = self.files.reference.days()
        words = f"{sum(days.values())} throws on {len(days)} days"
        return found.done("reference", words, reference_day_count=days)

    def _test(self, test: TestKind) -> LoadedSet:
        """Record an identification test and load its logs.

        Raises:
            UsageError: no log can be used.
        """
        folder = self.files.file("commissioning") / test
        self._record(test, 1, self.seed, folder)
        loaded = load_throws([folder])
        if not loaded.throws:
            raise UsageError(f"none of the logs in {folder} can be used: {loaded.refused[0][1]}")
        return loaded

    def _record(self, test: TestKind | None, throws: int, seed: int, folder: Path) -> None:
        campaigns: list[Campaign] = [
            open_campaign(
                mode=mode,
                plant=self.plant,
                targets=TARGETS,
                throws=throws,
                seed=seed,
                unit_seed=self.unit_seed,
                policies=self.policies,
                policy=None,
                calibration=self.files.calibration,
                profile=None,
                tables=self._tables(),
            )
            for mode in Mode
        ]
        machine = RecordedMachine(
            self.plant, self.unit_seed, self.files.profile, self.files.machine_id
        )
        record_campaign(campaigns, machine, test, throws, seed, folder)

    def _apply(self, changes: dict[str, Any], loaded: LoadedSet, what: str) -> TwinProfile:
        """The next version of the profile, written if anything was identified."""
        profile = load_profile(self.files.profile)
        note = f"{profile.note}; {what} identified from {len(loaded.throws)} logs"
        found = next_profile(profile, changes, self.files.machine_id, note)
        if found is None:
            self.show(f"  {what}: nothing was identified")
            return profile
        save_profile(found, self.files.profile)
        return found


def hash_of(day: str) -> int:
    """A seed for the throws of a day: other starts than on other days."""
    return sum(ord(letter) * (place + 1) for place, letter in enumerate(day))
