"""`downrange identify`: response, release delay and swing of a machine from its logs."""

import json as json_text
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import tyro
from matplotlib.figure import Figure

from diagnosis.identification.free_swing import (
    PAPER_COULOMB_RAD_PER_S2,
    PAPER_VISCOUS_PER_S,
    identify_swing,
)
from diagnosis.identification.plots import release_figure, response_figure, swing_figure
from diagnosis.identification.profile_update import (
    next_profile,
    with_release,
    with_response,
    with_swing,
)
from diagnosis.identification.quantity import Quantity
from diagnosis.identification.release_delay import (
    PAPER_COUNT,
    PAPER_MEAN_S,
    PAPER_SD_S,
    ReleaseDelay,
    identify_release,
)
from diagnosis.identification.response import identify_response
from diagnosis.identification.training_ranges import training_ranges
from diagnosis.loading.logs import load_throws
from diagnosis.loading.throw_data import LoadedSet
from machine.errors import UsageError
from machine.spec import load_spec
from sim_twin.throws.plots import check_plot_path
from sim_twin.twin.profile import TwinProfile, load_profile, nominal_profile, save_profile


def response(
    logs: tyro.conf.Positional[tuple[Path, ...]],
    /,
    *,
    profile: Path | None = None,
    json: Path | None = None,
    plot: Path | None = None,
    apply: Path | None = None,
) -> int:
    """Find dead time, lag, gain and limits of each driven joint, by direction, from throws or valve steps.

    Each number has a 90 % interval from a bootstrap over throws. A number that the motion does not excite is
    reported as unknown, with the reason. Throws also give the ranges of the closed loop for training.

    Example: downrange record --test response --out logs; downrange identify response logs --apply m001.json

    Args:
        logs: throw logs (MCAP) of one machine, or folders of them.
        profile: twin profile to be extended; the one in the logs if left out, or nominal.
        json: file for the whole result.
        plot: file for measured against modelled speeds (.png, .svg or .pdf).
        apply: file for the next version of the twin profile.
    """
    loaded, twin = _open(logs, profile, plot)
    spec = load_spec()
    joints = identify_response(loaded.throws, spec)
    for joint in joints:
        share = "" if joint.r2_ratio is None else f", explains {joint.r2_ratio:.1%}"
        print(f"{joint.joint} ({joint.block_count} pieces{share})")
        _print_table({"both": joint.shared, **joint.directions})
    ranges = training_ranges(loaded.throws, spec)
    print("ranges for training, reference to velocity:")
    for name, found in ranges.items():
        listed = ", ".join(
            f"{key} {value[0]:.3g}..{value[1]:.3g}" if isinstance(value, tuple) else f"{key} ?"
            for key, value in found.items()
        )
        print(f"  {name}: {listed}")
    result = {"joints": [j.model_dump(mode="json") for j in joints], "training": ranges}
    figure = None if plot is None else response_figure(loaded.throws, spec, joints, _title(loaded))
    _finish(loaded, result, json, plot, figure)
    _apply(apply, twin, with_response(twin, joints), loaded, "response")
    return 0


def release_delay(
    logs: tyro.conf.Positional[tuple[Path, ...]],
    /,
    *,
    profile: Path | None = None,
    json: Path | None = None,
    plot: Path | None = None,
    apply: Path | None = None,
) -> int:
    """Find how long the gripper takes to open, and how much that scatters, from openings at rest or throws.

    With a tracked load the time of release is measured, and so is the delay of the gripper's switch. Without
    a tracker the switch's nominal delay (15 to 40 ms) is subtracted, and its range widens the interval.

    Example: downrange record --test release --out logs; downrange identify release-delay logs

    Args:
        logs: throw logs (MCAP) of one machine, or folders of them.
        profile: twin profile to be extended; the one in the logs if left out, or nominal.
        json: file for the whole result.
        plot: file for the histogram (.png, .svg or .pdf).
        apply: file for the next version of the twin profile.
    """
    loaded, twin = _open(logs, profile, plot)
    found = identify_release(loaded.throws, load_spec())
    print(f"from the {found.method}, one opening to {1e3 * found.single_sd_s:.1f} ms:")
    _print_table({"": {"mean": found.mean, "sd": found.sd, "latch": found.latch}})
    print(
        f"paper: {1e3 * PAPER_MEAN_S:.0f} ms, sd {1e3 * PAPER_SD_S:.0f} ms, {PAPER_COUNT} releases"
    )
    figure = None if plot is None else _histogram(found, loaded)
    _finish(loaded, found.model_dump(mode="json"), json, plot, figure)
    _apply(apply, twin, with_release(found), loaded, "release delay")
    return 0


def swing(
    logs: tyro.conf.Positional[tuple[Path, ...]],
    /,
    *,
    profile: Path | None = None,
    json: Path | None = None,
    plot: Path | None = None,
    apply: Path | None = None,
) -> int:
    """Find viscous and dry friction and the effective length of the two free joints from free swings.

    Every swing of at least 4 s with all valves closed is used, wherever it is in the logs. The arm's motion
    against its closed valves is taken from the joint sensors.

    Example: downrange record --test swing --out logs; downrange identify swing logs --plot swing.svg

    Args:
        logs: throw logs (MCAP) of one machine, or folders of them.
        profile: twin profile to be extended; the one in the logs if left out, or nominal.
        json: file for the whole result.
        plot: file for the measured against the predicted swing (.png, .svg or .pdf).
        apply: file for the next version of the twin profile.
    """
    loaded, twin = _open(logs, profile, plot)
    spec = load_spec()
    axes = identify_swing(loaded.throws, spec)
    for axis in axes:
        print(f"{axis.joint} ({axis.swing_count} swings)")
        names = ("viscous_friction_per_s", "coulomb_friction_rad_per_s2", "length_m")
        _print_table({"": {name: getattr(axis, name) for name in names}})
    print(f"paper: {PAPER_VISCOUS_PER_S:g} 1/s and {PAPER_COULOMB_RAD_PER_S2:g} rad/s2, both axes")
    result = {axis.joint: axis.model_dump(mode="json") for axis in axes}
    figure = None if plot is None else swing_figure(axes, _title(loaded))
    _finish(loaded, result, json, plot, figure)
    _apply(apply, twin, with_swing(twin, axes, spec), loaded, "swing")
    return 0


def _open(
    logs: Sequence[Path], profile: Path | None, plot: Path | None
) -> tuple[LoadedSet, TwinProfile]:
    """The logs and the profile to extend.

    Raises:
        UsageError: no logs, none usable, or a plot that cannot be written.
    """
    if not logs:
        raise UsageError("give throw logs or folders of them")
    if plot is not None:
        check_plot_path(plot)
    loaded = load_throws(logs)
    if not loaded.throws:
        reasons = "; ".join(f"{path.name}: {why}" for path, why in loaded.refused[:3])
        raise UsageError(f"none of the logs can be used: {reasons}")
    if loaded.refused:
        path, why = loaded.refused[0]
        print(f"{len(loaded.refused)} logs left out, the first: {path.name}: {why}")
    inside = next((t.twin_profile for t in loaded.throws if t.twin_profile is not None), None)
    twin = load_profile(profile) if profile is not None else inside
    if profile is not None and twin is not None:
        _warn_of_another_machine(profile, twin.machine_id, loaded.throws[0].machine_id)
    return loaded, nominal_profile(load_spec()) if twin is None else twin


def _warn_of_another_machine(path: Path, profile_id: str, logs_id: str) -> None:
    """A warning only: a calibration and a recording may name the same machine differently."""
    if profile_id != logs_id:
        print(
            f"warning: {path} is the profile of machine '{profile_id}', the logs are of '{logs_id}'; "
            "if these are two machines, leave --profile out or give the right one"
        )


def _title(loaded: LoadedSet) -> str:
    return f"{loaded.throws[0].machine_id}, {len(loaded.throws)} logs"


def _histogram(found: ReleaseDelay, loaded: LoadedSet) -> Figure:
    if not found.delays_s:
        raise UsageError("no opening was seen: there is nothing to plot")
    return release_figure(found, _title(loaded))


def _print_table(groups: Mapping[str, Mapping[str, Quantity]]) -> None:
    for group, quantities in groups.items():
        for name, known in quantities.items():
            label = f"  {group} {name}".replace("  ", " ")
            # The unit 1 of ratios is not printed.
            unit = "" if known.unit == "1" else known.unit
            if known.value is None:
                reached = (
                    ""
                    if known.at_least is None
                    else f"; reached {known.at_least:.3g} {unit}".rstrip()
                )
                print(f" {label:<42} ? {known.why}{reached}")
                continue
            low, high = known.ci90 or (known.value, known.value)
            more = f" ({known.why})" if known.why else ""
            interval = f"{low:.4g} .. {high:.4g}, n {known.count}{more}"
            print(f" {label:<42} {known.value:8.4g} {unit:<6} {interval}")


def _finish(
    loaded: LoadedSet,
    result: Mapping[str, Any],
    json: Path | None,
    plot: Path | None,
    figure: Figure | None,
) -> None:
    whole = {
        "machine_id": loaded.throws[0].machine_id,
        "result": result,
        "evidence": loaded.evidence(),
    }
    try:
        if json is not None:
            json.write_text(json_text.dumps(whole, indent=2) + "\n", encoding="utf-8")
        if plot is not None and figure is not None:
            figure.savefig(plot, dpi=130)
    except OSError as error:
        raise UsageError(f"cannot write {error.filename}: {error.strerror}") from error


def _apply(
    path: Path | None, twin: TwinProfile, changes: Mapping[str, Any], loaded: LoadedSet, what: str
) -> None:
    if path is None:
        return
    note = f"{twin.note}; {what} identified from {len(loaded.throws)} logs"
    found = next_profile(twin, changes, loaded.throws[0].machine_id, note)
    if found is None:
        print(f"nothing was identified; {path} was not written")
        return
    save_profile(found, path)
    print(f"twin profile version {found.version_count}: {path}")


ACTIONS = {"response": response, "release-delay": release_delay, "swing": swing}
