"""`downrange diagnose`: locate the gap between twin and machine and name its cause; throws or one stage."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from cli.reference_choice import choose_reference
from diagnosis.correction import corrected_profile, found_effects
from diagnosis.diagnose import diagnose_throws
from diagnosis.loading.kept_reference import with_reference_stated
from diagnosis.loading.logs import load_throws
from diagnosis.report.diagnosis_page import diagnosis_html
from diagnosis.verdict import EXIT_CODES, Diagnosis
from machine.errors import UsageError
from machine.spec import load_spec
from sim_twin.twin.profile import load_profile, nominal_profile, save_profile

if TYPE_CHECKING:
    from diagnosis.tables.table import ReadOptions
# One stage's diagnosis is imported where it is called: it loads pandas, which help and throws do not need.


def throws(
    logs: tyro.conf.Positional[tuple[Path, ...]],
    /,
    *,
    reference: tyro.conf.UseAppendAction[tuple[str, ...]] = (),
    machines: Path = Path("data/machines"),
    profile: Path | None = None,
    material_m: float | None = None,
    json: Path | None = None,
    html: Path | None = None,
    apply: Path | None = None,
) -> int:
    """Compare a machine's throws with its twin: stage of the gap, missing effect, share that it removes.

    Example: downrange diagnose throws logs/m001 --profile m001.profile.json --json gap.json --html gap.html

    They are compared with reference throws of the same machine while it was healthy: those that `downrange
    commission` has kept, or others: downrange diagnose throws logs/today --reference logs/commissioning

    Exit code 0 explained or no gap, 2 ambiguous, 3 unknown effect, 4 unusable data, 1 an error.

    Args:
        logs: throw logs of one machine (MCAP, or CSV with one file a throw: docs/throw_log.md), or folders of
            them; at least 3 throws, better 12.
        reference: throw log or folder of the same machine while it was healthy, to compare with; may be given
            several times, at least 12 throws altogether, better 24 of two days, none of them diagnosed. If
            left out, those that are kept beside the profile or in --machines; none compares with healthy
            machines of the type, which finds large effects only.
        machines: folder of machines with their kept reference throws.
        profile: twin profile of the machine; the one in the logs if left out, or nominal.
        material_m: an effect that moves the impact by less is reported as seen and not claimed; effects of
            pose and sensors always are claimed.
        json: file for the whole result.
        html: file for the report, one page that needs no network.
        apply: file for the next version of the twin profile with the effects found, if there are any.
    """
    if not logs:
        raise UsageError("give throw logs or folders of them: downrange diagnose throws LOG...")
    _check_positive(material_m=material_m)
    loaded = load_throws(logs)
    previewed = next((t.twin_profile for t in loaded.throws if t.twin_profile is not None), None)
    twin = load_profile(profile) if profile is not None else previewed
    twin = nominal_profile(load_spec()) if twin is None else twin
    beside = () if profile is None else (profile.parent,)
    chosen = choose_reference(reference, loaded, (*beside, machines))
    if chosen.words:
        print(chosen.words)
    show = _progress_printer()
    found = diagnose_throws(
        loaded,
        twin,
        lambda share, text: show(f"{share:4.0%} {text}"),
        reference=chosen.throws,
        material_m=material_m,
        store=chosen.store,
    )
    found = with_reference_stated(found, chosen.days)
    if apply is not None and (effects := found_effects(found)):
        note = f"{twin.note}; diagnosis of {', '.join(str(path) for path in logs)}"
        save_profile(corrected_profile(twin, found, twin.machine_id, note), apply)
        print(f"twin profile with {len(effects)} more effects: {apply}")
    elif apply is not None:
        print(f"nothing to apply: the verdict is {found.verdict.value}; {apply} was not written")
    return _finish(found, json, html, "Throws")


def actuation(
    file: tyro.conf.Positional[Path],
    /,
    *,
    time: str | None = None,
    command: str | None = None,
    position: str | None = None,
    velocity: str | None = None,
    group: str | None = None,
    kind: Literal["auto", "speed", "position"] = "auto",
    decimal: Literal["auto", "point", "comma"] = "auto",
    missing: str = "",
    topic: tyro.conf.UseAppendAction[tuple[str, ...]] = (),
    field: tyro.conf.UseAppendAction[tuple[str, ...]] = (),
    json: Path | None = None,
    html: Path | None = None,
) -> int:
    """Find what lies between a valve command and a joint's motion, from a CSV file of any machine.

    Names dead time, lag, dead band and gain per direction, hysteresis, speed limit, stiction and backlash,
    with 90 % intervals and the share of the gap that they remove on held-out pieces of the record. Needs no
    model of the machine. Record steps of several sizes in both directions, with rests, at 25 Hz or more.

    Example: downrange diagnose actuation slew.csv --time time_s --command joystick --position slew_rad

    Several joints: --command boom_cmd,arm_cmd --position boom_rad,arm_rad

    Exit code 0 explained or no gap, 2 ambiguous, 3 unknown effect, 4 unusable data, 1 an error.

    Args:
        file: table with a header line; comma, semicolon, tab or blanks between the cells.
        time: column of times; found by its name if that is unambiguous. Units by name (_ms, _us) or step.
        command: column of commands, any scale, or several with commas.
        position: column of positions; deg, mm and angles that wrap are converted.
        velocity: column of velocities, if there is no position.
        group: column that separates runs; a restart of time does so too.
        kind: whether a constant command means a constant speed or a position; auto tries both.
        decimal: sign before the decimals, if the cells leave it open.
        missing: cells that stand for no value, separated by commas.
        topic: topic of a ROS bag or MCAP file instead of a table; may be given several times.
        field: for each --topic its fields, as position[1],velocity[1] or twist.linear.x; the first column is
            then called /joint_states/position[1].
        json: file for the whole result.
        html: file for the report.
    """
    from diagnosis.single_stage.csv_diagnosis import diagnose_actuation_csv

    found = diagnose_actuation_csv(
        file,
        time,
        command,
        position,
        velocity,
        group,
        kind,
        _progress_printer(),
        _options(decimal, missing, topic, field),
    )
    return _finish(found, json, html, f"Actuation, {file.name}")


def swing(
    file: tyro.conf.Positional[Path],
    /,
    *,
    time: str | None = None,
    angle: str | None = None,
    group: str | None = None,
    length_m: float | None = None,
    angle_unit: Literal["auto", "rad", "deg"] = "auto",
    fps: float | None = None,
    counts_per_turn: float | None = None,
    decimal: Literal["auto", "point", "comma"] = "auto",
    missing: str = "",
    topic: tyro.conf.UseAppendAction[tuple[str, ...]] = (),
    field: tyro.conf.UseAppendAction[tuple[str, ...]] = (),
    json: Path | None = None,
    html: Path | None = None,
) -> int:
    """Find which friction a freely swinging joint has, from a CSV file of its angle.

    Separates viscous friction, Coulomb friction and air drag; with --length-m also a wrong length or a
    stiff hose. A gyro, a tracked bob (x and y) or a mass on a spring may be recorded instead. Record from the
    release until the swing has died down.

    Example: downrange diagnose swing pendulum.csv --time t --angle theta_deg

    Exit code 0 explained or no gap, 2 ambiguous, 3 unknown effect, 4 unusable data, 1 an error.

    Args:
        file: table with a header line.
        time: column of times.
        angle: column of angles.
        group: column that separates several swings; a pause or a restart of time does so too.
        length_m: length of the ideal pendulum; without it the frequency is taken from the data.
        angle_unit: unit of the angle; auto takes the column's name, or degrees beyond 2 pi.
        fps: frames a second, when the times are frame numbers of a film.
        counts_per_turn: of an encoder, when the angle is in counts.
        decimal: sign before the decimals, if the cells leave it open.
        missing: cells that stand for no value, separated by commas.
        topic: topic of a ROS bag or MCAP file instead of a table; may be given several times.
        field: for each --topic its fields, as position[1],velocity[1] or twist.linear.x; the first column is
            then called /joint_states/position[1].
        json: file for the whole result.
        html: file for the report.
    """
    from diagnosis.single_stage.csv_diagnosis import diagnose_swing_csv

    _check_positive(fps=fps, counts_per_turn=counts_per_turn)
    found = diagnose_swing_csv(
        file,
        time,
        angle,
        group,
        length_m,
        angle_unit,
        fps,
        counts_per_turn,
        _progress_printer(),
        _options(decimal, missing, topic, field),
    )
    return _finish(found, json, html, f"Swing, {file.name}")


def flight(
    file: tyro.conf.Positional[Path],
    /,
    *,
    time: str | None = None,
    x: str | None = None,
    y: str | None = None,
    z: str | None = None,
    group: str | None = None,
    mass_kg: float | None = None,
    diameter_m: float | None = None,
    length_unit: Literal["auto", "m", "cm", "mm", "ft", "in", "yd", "px"] = "auto",
    fps: float | None = None,
    decimal: Literal["auto", "point", "comma"] = "auto",
    missing: str = "",
    topic: tyro.conf.UseAppendAction[tuple[str, ...]] = (),
    field: tyro.conf.UseAppendAction[tuple[str, ...]] = (),
    json: Path | None = None,
    html: Path | None = None,
) -> int:
    """Find what acts on a flying ball besides gravity, from a CSV file of its tracked positions.

    Separates air drag (and its fall at high speed), wind, spin and a late release, or states that gravity
    suffices. A height suffices for drops.

    Example: downrange diagnose flight drops.csv --time time_s --z height_m --group ball

    Exit code 0 explained or no gap, 2 ambiguous, 3 unknown effect, 4 unusable data, 1 an error.

    Args:
        file: table with a header line.
        time: column of times.
        x: column along the throw.
        y: column to its left; needs x.
        z: column of heights, up; for a film in x and y give --x x --z y.
        group: column that separates balls, and more after commas for flights of a ball; a restart of time
            begins another flight, too.
        mass_kg: of the ball; with the diameter, drag is given as a coefficient.
        diameter_m: of the ball.
        length_unit: of the positions; auto takes the columns' names. px takes the scale from gravity.
        fps: frames a second, when the times are frame numbers of a film.
        decimal: sign before the decimals, if the cells leave it open.
        missing: cells that stand for no value, separated by commas.
        topic: topic of a ROS bag or MCAP file instead of a table; may be given several times.
        field: for each --topic its fields, as position[1],velocity[1] or twist.linear.x; the first column is
            then called /joint_states/position[1].
        json: file for the whole result.
        html: file for the report.
    """
    from diagnosis.single_stage.csv_diagnosis import diagnose_flight_csv
    from diagnosis.single_stage.flight_problem import BallProperties

    _check_positive(fps=fps)
    if (mass_kg is None) != (diameter_m is None):
        raise UsageError("give both --mass-kg and --diameter-m, or neither")
    if mass_kg is not None and diameter_m is not None and min(mass_kg, diameter_m) <= 0.0:
        raise UsageError(f"--mass-kg {mass_kg} --diameter-m {diameter_m}: both must be positive")
    if z is None and (x is not None or y is not None):
        raise UsageError("give --z, the column that points up (for a film in x and y: --x x --z y)")
    axes = [name for name in (x, y, z) if name is not None]
    ball = (
        BallProperties()
        if mass_kg is None or diameter_m is None
        else BallProperties(mass_kg, diameter_m)
    )
    found = diagnose_flight_csv(
        file,
        time,
        axes,
        group,
        ball,
        length_unit,
        fps,
        _progress_printer(),
        _options(decimal, missing, topic, field),
    )
    return _finish(found, json, html, f"Flight, {file.name}")


def _options(
    decimal: Literal["auto", "point", "comma"],
    missing: str,
    topics: Sequence[str],
    fields: Sequence[str],
) -> "ReadOptions":
    """What the user says about a file."""
    from diagnosis.tables.table import ReadOptions
    from diagnosis.tables.topics import TopicField

    if len(topics) != len(fields):
        raise UsageError(
            f"{len(topics)} --topic and {len(fields)} --field: give one --field after each --topic; several "
            "fields of a topic are separated by commas"
        )
    columns = [
        TopicField(topic, name.strip())
        for topic, names in zip(topics, fields, strict=True)
        for name in names.split(",")
    ]
    texts = tuple(text.strip() for text in missing.split(",") if text.strip())
    return ReadOptions(decimal, texts, tuple(columns))


def _check_positive(**options: float | None) -> None:
    """Refuse options that must be positive and are not."""
    for name, value in options.items():
        if value is not None and not value > 0.0:
            raise UsageError(f"--{name.replace('_', '-')} {value:g}: it must be positive")


def _finish(found: Diagnosis, json: Path | None, html: Path | None, title: str) -> int:
    """Print the verdict, write the files, and give the exit code."""
    parts: dict[str, dict[str, str]] = found.evidence.get("parts", {})
    if parts:
        print(found.verdict.value)
        for name, part in parts.items():
            print(f"  {name}, {part['verdict']}: {part['sentence']}")
    else:
        print(f"{found.verdict.value}: {found.sentence}")
        for cause in found.causes[:5]:
            print(f"  {cause.probability:5.2f}  {cause.name}")
    if found.ambiguity is not None:
        print(
            f"To tell {' from '.join(found.ambiguity.members)}: {found.ambiguity.separating_motion['words']}"
        )
    for note in found.evidence.get("notes", []):
        print(f"note: {note}")
    try:
        if json is not None:
            json.write_text(found.model_dump_json(indent=2) + "\n", encoding="utf-8")
        if html is not None:
            html.write_text(diagnosis_html(found, title), encoding="utf-8")
    except OSError as error:
        raise UsageError(f"cannot write {error.filename}: {error.strerror}") from error
    return int(EXIT_CODES[found.verdict])


def _progress_printer() -> Callable[[str], None]:
    """Printer of progress on stderr; silent without a terminal."""

    def show(text: str) -> None:
        if sys.stderr.isatty():
            print(f"\r\x1b[K{text[:100]}", end="", file=sys.stderr, flush=True)

    return show


ACTIONS = {"throws": throws, "actuation": actuation, "swing": swing, "flight": flight}
