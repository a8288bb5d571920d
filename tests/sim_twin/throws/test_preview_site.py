"""Previews among boxes and pits: what the load meets, what the arm comes near to."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from machine.messages import Target
from machine.site.objects import SiteObject
from sim_twin.throws.clearances import SITE_MARGIN_M
from sim_twin.throws.preview import PreviewRequest, ThrowPreview, preview
from tests.sim_twin.throws.test_preview import request as plain_request


def box(name: str, x_m: float, height_m: float, length_m: float = 1.6) -> SiteObject:
    return SiteObject(
        name=name, kind="box", x_m=x_m, y_m=0.0, length_m=length_m, width_m=3.0, height_m=height_m
    )


@pytest.fixture(scope="module")
def request_2d(swing_policies: Path) -> PreviewRequest:
    return plain_request(swing_policies)


@pytest.fixture(scope="module")
def free(request_2d: PreviewRequest) -> ThrowPreview:
    """The throw with nothing in its way; the hand-made policy does not aim."""
    return preview(request_2d)


def test_a_load_lands_on_the_bed_under_its_target(
    request_2d: PreviewRequest, free: ThrowPreview
) -> None:
    assert free.lands_on == "ground"
    assert free.impact_m is not None
    x_m = free.impact_m[0]
    bed = box("bed", x_m - 0.2, 0.4)
    target = Target(x_m=x_m - 0.1, y_m=free.impact_m[1], z_m=0.4)
    shown = preview(replace(request_2d, site=(bed,), target=target, rollout_count=60))
    assert shown.refused == ()
    assert shown.lands_on == "bed"
    assert shown.impact_m is not None
    assert shown.impact_m[2] == pytest.approx(0.4, abs=1e-6)
    assert shown.impact_m[0] < x_m - 0.05
    assert shown.ball_path_m[-1, 2] == pytest.approx(0.4 + 0.1218, abs=1e-3)
    assert shown.flight_s < free.flight_s
    assert shown.ellipse is not None
    assert shown.ellipse.landed_count == 60


def test_a_load_that_hits_a_side_is_refused_with_where(
    request_2d: PreviewRequest, free: ThrowPreview
) -> None:
    assert free.impact_m is not None
    wall = box("wall", free.impact_m[0] + 0.19, 0.5, length_m=0.2)
    shown = preview(replace(request_2d, site=(wall,), rollout_count=20))
    assert shown.lands_on == "wall"
    assert "hits the side of wall at height +0." in shown.refused[0].detail
    assert "hit the side of wall" in shown.refused[-1].detail


def test_a_load_that_falls_beside_what_it_is_meant_for_is_refused(
    request_2d: PreviewRequest, free: ThrowPreview
) -> None:
    assert free.impact_m is not None
    bed = box("bed", free.impact_m[0] + 1.0, 0.1)
    target = Target(x_m=free.impact_m[0] + 0.25, y_m=0.0, z_m=0.1)
    shown = preview(replace(request_2d, site=(bed,), target=target))
    assert [r.detail for r in shown.refused] == [
        "Refused: the load lands on ground, not on bed. Choose another target."
    ]


def test_a_load_lands_in_the_pit(request_2d: PreviewRequest, free: ThrowPreview) -> None:
    assert free.impact_m is not None
    pit = SiteObject(
        name="pit", kind="pit", x_m=6.0, y_m=0.0, length_m=1.4, width_m=1.4, height_m=0.5
    )
    target = Target(x_m=6.0, y_m=0.0, z_m=-0.5)
    shown = preview(replace(request_2d, site=(pit,), target=target))
    assert shown.refused == ()
    assert shown.lands_on == "pit"
    assert shown.impact_m is not None
    assert shown.impact_m[2] == pytest.approx(-0.5, abs=1e-6)
    assert shown.impact_m[0] > free.impact_m[0]
    # Asked for at the height of the ground, where there is none.
    over = preview(replace(request_2d, site=(pit,)))
    assert [(r.detail, r.surface_m) for r in over.refused] == [
        (
            "Refused: the target at +0.00 m hangs above pit, whose floor there is at -0.50 m. "
            "Use that height, or choose another point.",
            -0.5,
        )
    ]


def test_a_target_in_the_air_beside_a_bed_is_refused(request_2d: PreviewRequest) -> None:
    bed = box("bed", 8.0, 0.4)
    beside = preview(replace(request_2d, site=(bed,), target=Target(x_m=6.0, y_m=0.0, z_m=0.4)))
    assert [r.detail for r in beside.refused] == [
        "Refused: nothing is +0.40 m high 1.20 m beside bed, where the ground is at +0.00 m. "
        "Use that height, or choose another point."
    ]
    assert beside.refused[0].surface_m == 0.0
    inside = preview(replace(request_2d, site=(bed,), target=Target(x_m=8.0, y_m=0.0)))
    assert "+0.00 m lies inside bed, whose top there is at +0.40 m" in inside.refused[0].detail
    assert inside.refused[0].surface_m == pytest.approx(0.4)
    far = preview(replace(request_2d, target=Target(x_m=6.0, y_m=0.0, z_m=0.4)))
    assert far.lands_on == "surface at the target's height"
    assert far.refused == ()


def test_the_arm_keeps_its_distance_from_what_stands_around(request_2d: PreviewRequest) -> None:
    pillar = SiteObject(
        name="pillar", kind="box", x_m=4.6, y_m=0.0, length_m=0.4, width_m=0.4, height_m=3.0
    )
    shown = preview(replace(request_2d, site=(pillar,)))
    near = {c.name: c for c in shown.clearances}["arm or gripper to pillar"]
    assert near.value_rad_m < near.limit_rad_m == SITE_MARGIN_M
    assert any("arm or gripper to pillar" in r.detail for r in shown.refused)
    far = pillar.model_copy(update={"x_m": -12.0})
    away = preview(replace(request_2d, site=(far,)))
    assert away.refused == ()
    distance = {c.name: c for c in away.clearances}["arm or gripper to pillar"].value_rad_m
    assert 12.0 < distance < 13.0


def test_distances_of_the_arm_are_those_that_mujoco_finds(request_2d: PreviewRequest) -> None:
    """The same pose against the same box, given to MuJoCo as one of its own shapes."""
    import mujoco

    from machine.site.solids import Solids
    from machine.spec import MJCF_PATH
    from sim_twin.throws.clearances import ARM_SHAPES, solid_clearances

    item = SiteObject(
        name="bed",
        kind="box",
        x_m=6.5,
        y_m=1.5,
        turn_rad=0.5,
        length_m=2.0,
        width_m=1.0,
        height_m=1.2,
    )
    tree = mujoco.MjSpec.from_file(str(MJCF_PATH))
    geom = tree.worldbody.add_geom(name="bed", type=mujoco.mjtGeom.mjGEOM_BOX)
    geom.pos, geom.size = [6.5, 1.5, 0.6], [1.0, 0.5, 0.6]
    geom.quat = [np.cos(0.25), 0.0, 0.0, np.sin(0.25)]
    model = tree.compile()
    data = mujoco.MjData(model)
    pose = np.array([*request_2d.joint_position_rad_m[:4], 0.3, 0.1])
    data.qpos[:] = pose
    mujoco.mj_kinematics(model, data)
    segment = np.zeros(6)
    exact = min(
        float(
            mujoco.mj_geomDistance(
                model, data, model.geom(n).id, model.geom("bed").id, 50.0, segment
            )
        )
        for n in ARM_SHAPES
    )
    found = {
        c.name: c.value_rad_m for c in solid_clearances(pose[None], 0.02, solids=Solids([item]))
    }
    assert found["arm or gripper to bed"] == pytest.approx(exact, abs=0.015)
