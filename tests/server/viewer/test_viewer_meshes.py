import json

import mujoco
import numpy as np
import pytest

from machine.spec import MJCF_PATH, load_spec
from server.viewer.meshes import PartMesh, part_meshes
from server.viewer.nodes import MachineKit
from server.viewer.pose import stroke_m
from tests.cases import each

MODEL = mujoco.MjModel.from_xml_path(str(MJCF_PATH))
KIT = MachineKit.load(load_spec())
MOVED = ["chassis", "upper", "boom", "dipper", "telescope", "hanger", "gripper", "payload"]


def test_every_body_is_drawn() -> None:
    assert set(part_meshes(MODEL)) == set(MOVED)


def test_visual_geoms_act_on_nothing() -> None:
    visual = MODEL.geom_group == 2
    assert visual.any()
    assert not MODEL.geom_contype[visual].any()
    assert not MODEL.geom_conaffinity[visual].any()


def extent(geom_id: int) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner of a geom in its body's frame, by the formula of its kind."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, MODEL.geom_quat[geom_id])
    turn, centre = matrix.reshape(3, 3), MODEL.geom_pos[geom_id]
    kind, size, kinds = MODEL.geom_type[geom_id], MODEL.geom_size[geom_id], mujoco.mjtGeom
    axis = np.abs(turn[:, 2])
    if kind == kinds.mjGEOM_MESH:
        mesh = MODEL.geom_dataid[geom_id]
        first = MODEL.mesh_vertadr[mesh]
        corners = MODEL.mesh_vert[first : first + MODEL.mesh_vertnum[mesh]] @ turn.T
        return centre + corners.min(axis=0), centre + corners.max(axis=0)
    if kind == kinds.mjGEOM_BOX:
        half = np.abs(turn) @ size
    elif kind == kinds.mjGEOM_CAPSULE:
        half = axis * size[1] + size[0]
    elif kind == kinds.mjGEOM_CYLINDER:
        half = axis * size[1] + size[0] * np.sqrt(np.maximum(0.0, 1.0 - axis**2))
    else:
        half = np.full(3, size[0])
    return centre - half, centre + half


@each("name", MOVED)
def test_a_mesh_lies_where_its_geoms_are(name: str) -> None:
    vertices, faces = KIT.meshes[name].merged
    assert np.isfinite(vertices).all()
    assert faces.max() < len(vertices)
    body_id = MODEL.body(name).id
    mine = [
        extent(i)
        for i in range(MODEL.ngeom)
        if MODEL.geom_bodyid[i] == body_id and MODEL.geom_group[i] == 2
    ]
    # Facets cut the corners of round shapes by millimetres.
    low, high = np.min([a for a, _ in mine], axis=0), np.max([b for _, b in mine], axis=0)
    np.testing.assert_allclose(vertices.min(axis=0), low, atol=0.02)
    np.testing.assert_allclose(vertices.max(axis=0), high, atol=0.02)


@each("name", sorted(KIT.glb))
def test_glb_holds_one_primitive_a_material(name: str) -> None:
    glb = KIT.glb[name]
    assert glb[:4] == b"glTF"
    length = int.from_bytes(glb[12:16], "little")
    tree = json.loads(glb[20 : 20 + length])
    patches = KIT.meshes[name].patches
    assert len(tree["meshes"]) == len(patches)
    assert len({patch.surface for patch in patches}) == len(patches)


def test_one_view_costs_less_than_two_megabytes() -> None:
    assert sum(len(glb) for glb in KIT.glb.values()) < 2_000_000


def test_rods_stay_in_their_barrels_and_short_of_the_base_pin() -> None:
    spec = load_spec()
    for joint, index in (("boom", 1), ("dipper", 2)):
        cylinder = getattr(spec.hydraulics, f"{joint}_cylinder")
        low, high = (
            spec.limits.position_min_rad_m[index],
            spec.limits.position_max_rad_m[index],
        )
        assert low is not None
        assert high is not None
        shortest, longest = stroke_m(cylinder, low, high)
        barrel_end = float(KIT.meshes[f"{joint}_barrel"].merged[0][:, 0].max())
        rod_start = float(KIT.meshes[f"{joint}_rod"].merged[0][:, 0].min())
        assert longest + rod_start < barrel_end - 0.05
        assert shortest + rod_start > 0.0
        assert barrel_end < shortest


def test_a_geom_that_cannot_be_drawn_is_named() -> None:
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1" group="2"/>'
        "</worldbody></mujoco>"
    )
    with pytest.raises(ValueError, match="'floor'"):
        part_meshes(model)


def test_merged_faces_point_at_their_own_patch() -> None:
    mesh: PartMesh = KIT.meshes["chassis"]
    vertices, faces = mesh.merged
    first = 0
    for patch in mesh.patches:
        part = faces[first : first + len(patch.faces)]
        np.testing.assert_array_equal(vertices[part], patch.vertices_m[patch.faces])
        first += len(patch.faces)
    assert first == len(faces)
