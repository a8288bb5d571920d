"""What is drawn of the machine: one mesh a part, made from the model's visual geoms (group 2).

Edges sharper than 35 degrees stay sharp, all others are shaded smooth. Nothing here acts: collision
geoms are not looked at.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from machine.conventions import Array
from machine.spec import CylinderSpec
from server.viewer.pose import stroke_m

VISUAL_GROUP = 2
SMOOTH_ANGLE_RAD = math.radians(35.0)
CHAMFER_M = 0.018
"""Chamfer of box edges: sheet steel is welded, not razor sharp, and the edge catches light."""
ROUND_SECTIONS = 32
LUG_PAIRS = 15


class Surface(NamedTuple):
    """Physically based material, sRGB 0..1."""

    rgba: tuple[float, float, float, float]
    metallic_ratio: float
    roughness_ratio: float


@dataclass(frozen=True)
class Patch:
    """The triangles of one material in a part's frame."""

    surface: Surface
    vertices_m: NDArray[np.float32]
    """Shape (V, 3)."""
    faces: NDArray[np.uint32]
    """Shape (F, 3)."""


@dataclass(frozen=True)
class PartMesh:
    """All that is drawn of one part."""

    patches: tuple[Patch, ...]

    @property
    def merged(self) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
        """All triangles as one mesh, for one-coloured drawing; shapes (V, 3) and (F, 3)."""
        vertices = np.concatenate([patch.vertices_m for patch in self.patches])
        offsets = np.cumsum([0] + [len(patch.vertices_m) for patch in self.patches[:-1]])
        faces = [patch.faces + offset for patch, offset in zip(self.patches, offsets, strict=True)]
        return vertices, np.concatenate(faces).astype(np.uint32)

    @property
    def glb(self) -> bytes:
        """Binary glTF with one primitive a material."""
        scene = trimesh.Scene()
        for patch in self.patches:
            mesh = trimesh.Trimesh(patch.vertices_m, patch.faces, process=False)
            mesh.visual = TextureVisuals(material=_material(patch.surface))
            scene.add_geometry(mesh)
        exported: Any = scene.export(file_type="glb")
        return bytes(exported)


def _material(surface: Surface) -> Any:
    # glTF wants linear light; the model's colours are sRGB.
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in surface.rgba[:3]]
    return PBRMaterial(
        baseColorFactor=[*linear, surface.rgba[3]],
        metallicFactor=surface.metallic_ratio,
        roughnessFactor=surface.roughness_ratio,
        alphaMode="BLEND" if surface.rgba[3] < 1.0 else "OPAQUE",
        doubleSided=surface.rgba[3] < 1.0,
    )


def part_meshes(model: mujoco.MjModel) -> dict[str, PartMesh]:
    """Visual meshes of all bodies that have any, by body name, in the body's frame."""
    collected: dict[str, dict[Surface, list[trimesh.Trimesh]]] = {}
    for geom_id in range(model.ngeom):
        if int(model.geom_group[geom_id]) != VISUAL_GROUP:
            continue
        name = model.body(int(model.geom_bodyid[geom_id])).name
        shape = _geom_shape(model, geom_id)
        shape.apply_transform(_geom_transform(model, geom_id))
        by_surface = collected.setdefault(name, {})
        by_surface.setdefault(_geom_surface(model, geom_id), []).append(shape)
    return {name: _part_mesh(by_surface) for name, by_surface in collected.items()}


def _part_mesh(by_surface: dict[Surface, list[trimesh.Trimesh]]) -> PartMesh:
    patches: list[Patch] = []
    for surface, shapes in by_surface.items():
        shaded = [_sharp_edges(shape) for shape in shapes]
        merged: Any = trimesh.util.concatenate(shaded)
        vertices = np.asarray(merged.vertices, dtype=np.float32)
        patches.append(Patch(surface, vertices, np.asarray(merged.faces, dtype=np.uint32)))
    # Glass last: it is blended over what is behind it.
    patches.sort(key=lambda patch: -patch.surface.rgba[3])
    return PartMesh(tuple(patches))


def _sharp_edges(shape: trimesh.Trimesh) -> trimesh.Trimesh:
    """Split vertices at sharp edges; the browser averages normals over shared vertices only."""
    return trimesh.graph.smooth_shade(shape, angle=SMOOTH_ANGLE_RAD)


def _geom_surface(model: mujoco.MjModel, geom_id: int) -> Surface:
    material_id = int(model.geom_matid[geom_id])
    if material_id < 0:
        r, g, b, a = (float(v) for v in model.geom_rgba[geom_id])
        return Surface((r, g, b, a), 0.0, 0.8)
    r, g, b, a = (round(float(v), 4) for v in model.mat_rgba[material_id])
    metallic = max(0.0, round(float(model.mat_metallic[material_id]), 3))
    roughness = round(float(model.mat_roughness[material_id]), 3)
    return Surface((r, g, b, a), metallic, roughness if roughness >= 0.0 else 0.7)


def _geom_transform(model: mujoco.MjModel, geom_id: int) -> Array:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, model.geom_quat[geom_id])
    transform = np.eye(4)
    transform[:3, :3] = matrix.reshape(3, 3)
    transform[:3, 3] = model.geom_pos[geom_id]
    return transform


def _geom_shape(model: mujoco.MjModel, geom_id: int) -> trimesh.Trimesh:
    """Mesh of a geom in its own frame."""
    kind = int(model.geom_type[geom_id])
    x, y, z = (float(v) for v in model.geom_size[geom_id])
    geoms = mujoco.mjtGeom
    if kind == int(geoms.mjGEOM_BOX):
        return _chamfered_box(x, y, z)
    if kind == int(geoms.mjGEOM_CYLINDER):
        return _tyre(x, y) if _is_rubber(model, geom_id) else _chamfered_cylinder(x, y)
    if kind == int(geoms.mjGEOM_CAPSULE):
        return trimesh.creation.capsule(height=2 * y, radius=x, count=(12, 12))
    if kind == int(geoms.mjGEOM_SPHERE):
        return trimesh.creation.icosphere(subdivisions=3, radius=x)
    if kind == int(geoms.mjGEOM_ELLIPSOID):
        return trimesh.creation.icosphere(subdivisions=3).apply_scale((x, y, z))
    if kind == int(geoms.mjGEOM_MESH):
        return _asset_mesh(model, int(model.geom_dataid[geom_id]))
    name = model.geom(geom_id).name
    raise ValueError(
        f"Visual geom {name!r} is of a kind that cannot be drawn; use a mesh or a box."
    )


def _is_rubber(model: mujoco.MjModel, geom_id: int) -> bool:
    material_id = int(model.geom_matid[geom_id])
    return material_id >= 0 and model.material(material_id).name == "rubber"


def _tyre(radius: float, half_width: float) -> trimesh.Trimesh:
    """A lugged tyre round the z axis in place of a rubber cylinder; hollow, so that the rim shows."""
    tread, bead = 0.94 * radius, 0.53 * radius
    profile = np.array(
        [
            (bead, -0.72 * half_width),
            (0.62 * radius, -0.92 * half_width),
            (0.80 * radius, -half_width),
            (tread, -0.84 * half_width),
            (tread + 0.012, 0.0),
            (tread, 0.84 * half_width),
            (0.80 * radius, half_width),
            (0.62 * radius, 0.92 * half_width),
            (bead, 0.72 * half_width),
            (bead, -0.72 * half_width),
        ]
    )
    shapes = [trimesh.creation.revolve(profile, sections=48)]
    lug = np.array(
        [
            (height, across * half_width, along + slant)
            for height, spread in ((tread - 0.02, 1.25), (radius, 1.0))
            for across, slant in ((0.04, 0.07), (0.96, -0.07))
            for along in (-0.034 * spread, 0.034 * spread)
        ]
    )
    for index in range(2 * LUG_PAIRS):
        # Left and right lugs alternate, so that the tread reads as a chevron.
        side = 1.0 if index % 2 else -1.0
        corners = lug * (1.0, side, 1.0)
        shape = trimesh.convex.convex_hull(corners[:, (0, 2, 1)])
        angle = index * math.pi / LUG_PAIRS
        shape.apply_transform(trimesh.transformations.rotation_matrix(angle, (0, 0, 1)))
        shapes.append(shape)
    merged: Any = trimesh.util.concatenate(shapes)
    return merged


def _asset_mesh(model: mujoco.MjModel, mesh_id: int) -> trimesh.Trimesh:
    first, count = int(model.mesh_vertadr[mesh_id]), int(model.mesh_vertnum[mesh_id])
    face, faces = int(model.mesh_faceadr[mesh_id]), int(model.mesh_facenum[mesh_id])
    return trimesh.Trimesh(
        np.array(model.mesh_vert[first : first + count], dtype=np.float64),
        np.array(model.mesh_face[face : face + faces]),
    )


def _chamfered_box(x: float, y: float, z: float) -> trimesh.Trimesh:
    c = min(CHAMFER_M, 0.3 * min(x, y, z))
    corners = np.array(
        [
            (sx * (x - cx), sy * (y - cy), sz * (z - cz))
            for sx in (-1, 1)
            for sy in (-1, 1)
            for sz in (-1, 1)
            for cx, cy, cz in ((c, c, 0.0), (c, 0.0, c), (0.0, c, c))
        ]
    )
    return trimesh.convex.convex_hull(corners)


def _chamfered_cylinder(radius: float, half_length: float) -> trimesh.Trimesh:
    c = min(CHAMFER_M, 0.2 * radius, 0.3 * half_length)
    profile = np.array(
        [
            (0.0, -half_length),
            (radius - c, -half_length),
            (radius, -half_length + c),
            (radius, half_length - c),
            (radius - c, half_length),
            (0.0, half_length),
        ]
    )
    return trimesh.creation.revolve(profile, sections=ROUND_SECTIONS)


def _along_x(radius: float, start: float, end: float) -> trimesh.Trimesh:
    shape = _chamfered_cylinder(radius, abs(end - start) / 2.0)
    turn = trimesh.transformations.rotation_matrix(math.pi / 2.0, (0, 1, 0))
    shape.apply_transform(turn)
    shape.apply_translation(((start + end) / 2.0, 0.0, 0.0))
    return shape


def cylinder_meshes(
    cylinder: CylinderSpec, low_rad: float, high_rad: float, painted: Surface, chrome: Surface
) -> tuple[PartMesh, PartMesh]:
    """Barrel and rod of a hydraulic cylinder that fits its joint's whole range.

    Args:
        cylinder: pins, bore and rod.
        low_rad: lower limit of the joint.
        high_rad: upper limit of the joint.
        painted: surface of barrel and eyes.
        chrome: surface of the rod.
    """
    shortest, longest = stroke_m(cylinder, low_rad, high_rad)
    outer = cylinder.bore_m / 2.0 + 0.018
    barrel_end = shortest - 0.13
    barrel = [
        _along_x(outer, 0.05, barrel_end),
        _along_x(outer + 0.014, barrel_end - 0.09, barrel_end),
        _along_x(outer + 0.008, 0.05, 0.13),
        _eye(outer),
    ]
    # The rod must still sit in the barrel when fully out, and end short of the base pin when fully in.
    rod_length = min(longest - barrel_end + 0.10, shortest - 0.08)
    rod = [_along_x(cylinder.rod_m / 2.0, -rod_length, -0.05)]
    head = [_eye(outer * 0.9), _along_x(cylinder.rod_m / 2.0 + 0.015, -0.12, -0.03)]
    return _part_mesh({painted: barrel}), _part_mesh({chrome: rod, painted: head})


def _eye(radius: float) -> trimesh.Trimesh:
    """Bearing eye round a pin along y."""
    shape = _chamfered_cylinder(radius, 0.055)
    shape.apply_transform(trimesh.transformations.rotation_matrix(math.pi / 2.0, (1, 0, 0)))
    return shape
