"""What a machine's measured throws tell of the loads to come, read from a real database."""

import math

import pytest

from machine.site.thrown_material import MaterialFootprint
from machine.spec import load_spec
from server.clock import new_id, utc_now
from server.jobs.throw_loads import SCATTER_COUNT, measured_loads, measured_scatter
from server.store.models import Plan, Throw
from server.throws.impacts import add_impact

POLICY = "a" * 64
ALONG_M2, ACROSS_M2 = 0.09, 0.01


def footprint(bearing_rad: float) -> MaterialFootprint:
    """A load that lies along a bearing."""
    cos, sin = math.cos(bearing_rad), math.sin(bearing_rad)
    return MaterialFootprint(
        volume_m3=0.2,
        covariance_m2=(
            ALONG_M2 * cos**2 + ACROSS_M2 * sin**2,
            (ALONG_M2 - ACROSS_M2) * sin * cos,
            ALONG_M2 * sin**2 + ACROSS_M2 * cos**2,
        ),
    )


def add(database, bearing_rad=0.0, *, material=None, lies=None, long_m=0.0, policy=POLICY):
    """A throw 8 m far that landed this long."""
    now, cos, sin = utc_now(), math.cos(bearing_rad), math.sin(bearing_rad)
    shared = {
        "plan_id": new_id(), "machine_id": "m001", "session_id": "s", "created_utc": now, "mode": "2d",
        "target_x_m": 8.0 * cos, "target_y_m": 8.0 * sin, "target_z_m": 0.0,
        "policy_sha256": policy, "policy_id": "p",
    }  # fmt: skip
    stuff = None if material is None else {"name": material}
    plan = Plan(
        **shared, created_by="ada", expires_utc=now, state="ready", model_sha256=load_spec().sha256,
        twin_profile_version=0, refusals=[], start_rad_m=[], material=stuff,
    )  # fmt: skip
    throw = Throw(
        **shared, throw_id=new_id(), operator="ada", epoch_count=1, range_m=8.0, phase="ended",
        outcome="landed",
    )  # fmt: skip
    database.add_all([plan, throw])
    database.flush()
    at = ((8.0 + long_m) * cos, (8.0 + long_m) * sin, 0.0)
    add_impact(database, throw, at, "survey", sd_m=None, recorded_by="m001", footprint=lies)


def test_loads_of_the_same_material_and_version_count_where_their_footprint_was_measured(assembled):
    with assembled.parts.database.write() as database:
        add(database, 0.7, material="gravel", lies=footprint(0.7), long_m=-0.2)
        add(database, material="gravel")
        add(database, material="sand", lies=footprint(0.0))
        add(database, material="gravel", lies=footprint(0.0), policy="b" * 64)
        add(database)
    with assembled.parts.database.read() as database:
        (load,) = measured_loads(database, "m001", "2d", POLICY, "gravel")
        assert measured_loads(database, "m002", "2d", POLICY, "gravel") == ()
    assert load.range_m == 8.0
    assert load.error_m == pytest.approx((-0.2, 0.0))
    assert load.variance_m2 == pytest.approx((ALONG_M2, ACROSS_M2))


def test_scatter_is_that_of_balls(assembled):
    with assembled.parts.database.write() as database:
        for number in range(SCATTER_COUNT):
            add(database, long_m=0.1 * (-1) ** number)
            add(database, material="gravel", long_m=5.0 * (-1) ** number)
    with assembled.parts.database.read() as database:
        (scatter,) = measured_scatter(database, "m001", "2d", POLICY)
    assert scatter.sd_downrange_m == pytest.approx(0.1, rel=0.1)
