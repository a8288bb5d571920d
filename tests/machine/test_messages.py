"""Messages: strict toward the machine, tolerant from it, and hashed so that nothing slips by."""

import hashlib
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from machine.conventions import Mode
from machine.messages import (
    AimShift,
    ArmRequest,
    Command,
    CommandReply,
    FireRequest,
    ImpactSurvey,
    StopRequest,
    Target,
    ThrowPlan,
    ThrowState,
)
from machine.site.thrown_material import MaterialFootprint, ThrownMaterial
from tests.cases import each

COMMAND = TypeAdapter[Command](Command)


GRAVEL = ThrownMaterial(
    name="gravel",
    volume_m3=0.25,
    mass_kg=380.0,
    grain_diameter_m=0.016,
    grain_spread_ratio=0.4,
    grain_density_kg_per_m3=2650.0,
    drag_coefficient_ratio=1.0,
)


def plan(**changes) -> ThrowPlan:
    fields = {
        "plan_id": "p1",
        "machine_id": "m001",
        "mode": Mode.PLANAR,
        "target": Target(x_m=9.0, y_m=0.0),
        "policy_sha256": "a" * 64,
        "model_sha256": "b" * 64,
        "twin_profile_version": 1,
        "predicted_impact_m": (9.0, 0.0, 0.0),
    }
    return ThrowPlan(**(fields | changes))


@given(st.floats(-60, 60), st.floats(-60, 60), st.floats(-5, 10))
def test_plan_hash_survives_the_wire_to_the_last_bit(x, y, z):
    sent = plan(target=Target(x_m=x, y_m=y, z_m=z))
    assert ThrowPlan.model_validate_json(sent.model_dump_json()).plan_hash == sent.plan_hash


@each(
    "change",
    [
        {"target": Target(x_m=9.0, y_m=1e-12)},
        {"mode": Mode.SPATIAL},
        {"pace_ratio": 0.26},
        {"policy_sha256": "c" * 64},
        {"machine_id": "m002"},
        {"predicted_impact_m": (9.0, 0.0, 1e-9)},
    ],
)
def test_plan_hash_changes_with_any_field(change):
    assert plan(**change).plan_hash != plan().plan_hash


def test_a_plan_of_a_ball_without_an_aim_correction_has_the_hash_that_older_software_knows():
    aim = AimShift(
        version_count=1,
        downrange_m=0.1,
        crossrange_m=0.0,
        policy_sha256="a" * 64,
        calibration_sha256="b" * 64,
    )
    content = plan().model_dump(
        mode="json",
        exclude={"allowed_radius_m", "zones_sha256", "swept_path_rad_m", "aim", "material"},
    )
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    assert plan().plan_hash == hashlib.sha256(text.encode()).hexdigest()
    hashes = {plan(aim=aim.model_copy(update={"downrange_m": m})).plan_hash for m in (0.1, 0.2)}
    assert len(hashes | {plan().plan_hash}) == 3
    assert plan(material=GRAVEL).plan_hash not in hashes | {plan().plan_hash}


def test_how_material_lies_comes_with_its_impact_and_must_be_a_covariance():
    lies = MaterialFootprint(volume_m3=0.25, covariance_m2=(0.25, 0.12, 0.16))
    sent = ImpactSurvey(position_m=(8.0, 0.0, 0.3), sd_m=0.02, source="survey", footprint=lies)
    assert ImpactSurvey.model_validate_json(sent.model_dump_json()) == sent
    older = sent.model_dump(exclude={"footprint"})
    assert ImpactSurvey.model_validate(older).footprint is None
    along, across = lies.sd_m
    assert along**2 + across**2 == pytest.approx(0.41) and along * across == pytest.approx(0.16)
    with pytest.raises(ValueError, match="no covariance"):
        MaterialFootprint(volume_m3=0.25, covariance_m2=(0.25, 0.3, 0.16))


@each("value", [float("nan"), float("inf"), 61.0, "far"])
def test_a_target_that_is_no_place_is_refused(value):
    with pytest.raises(ValidationError):
        Target(x_m=value, y_m=0.0)


@each("pace", [-0.01, 1.01, float("nan")])
def test_a_pace_outside_of_careful_and_fast_is_refused(pace):
    with pytest.raises(ValidationError):
        plan(pace_ratio=pace)


def test_the_machine_refuses_fields_it_does_not_know():
    with pytest.raises(ValidationError):
        StopRequest.model_validate(
            {"command_id": "1", "machine_id": "m", "issuer": "x", "hurry": True}
        )


def test_the_server_ignores_fields_it_does_not_know():
    reply = CommandReply.model_validate(
        {
            "command_id": "1",
            "machine_id": "m",
            "accepted": True,
            "state": "armed",
            "epoch_count": 3,
            "mood": "fine",
        }
    )
    assert reply.state is ThrowState.ARMED


@each(
    "command",
    [
        StopRequest(command_id="1", machine_id="m", issuer="i"),
        ArmRequest(command_id="2", machine_id="m", issuer="i", epoch_count=1, plan=plan()),
        FireRequest(
            command_id="3",
            machine_id="m",
            issuer="i",
            throw_id="t",
            epoch_count=1,
            nonce="n",
            plan_hash="h",
        ),
    ],
)
def test_commands_come_back_as_the_kind_they_left(command):
    assert COMMAND.validate_json(command.model_dump_json()) == command


def test_an_epoch_below_zero_is_refused():
    with pytest.raises(ValidationError):
        ArmRequest(command_id="2", machine_id="m", issuer="i", epoch_count=-1, plan=plan())
