"""The machine and its load as nodes of one browser's scene; only joints that moved are sent."""

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import viser

from machine.conventions import Array
from machine.spec import MJCF_PATH, MachineSpec
from server.viewer.meshes import PartMesh, Surface, cylinder_meshes, part_meshes
from server.viewer.pose import CylinderPart, JointPart, Part, local_pose, machine_parts
from server.viewer.theme import Rgb
from server.viewer.viewer_server import send_orientation

PAYLOAD = "payload"
PAINTED = Surface((0.20, 0.21, 0.23, 1.0), 0.2, 0.5)
CHROME = Surface((0.86, 0.87, 0.89, 1.0), 0.85, 0.25)


@dataclass(frozen=True)
class Tint:
    """One translucent colour over the whole machine: the preview's ghost, or a machine that is lost."""

    colour: Rgb
    opacity_ratio: float


@dataclass(frozen=True)
class MachineKit:
    """What every view of the machine type shares, made once."""

    parts: tuple[Part, ...]
    meshes: dict[str, PartMesh]
    glb: dict[str, bytes]
    ball_radius_m: float

    @staticmethod
    def load(spec: MachineSpec, mjcf_path: Path = MJCF_PATH) -> "MachineKit":
        """Compile the MJCF and mesh its visual geoms and the drawn cylinders."""
        model = mujoco.MjModel.from_xml_path(str(mjcf_path))
        parts = machine_parts(model, spec)
        meshes = part_meshes(model)
        for part in parts:
            if isinstance(part, CylinderPart):
                low = spec.limits.position_min_rad_m[part.joint_index] or 0.0
                high = spec.limits.position_max_rad_m[part.joint_index] or 0.0
                pair = cylinder_meshes(part.cylinder, low, high, PAINTED, CHROME)
                meshes[part.name] = pair[1 if part.is_rod else 0]
        glb = {name: mesh.glb for name, mesh in meshes.items()}
        return MachineKit(parts, meshes, glb, spec.ball.radius_m)


class MachineNodes:
    """One drawn machine in one browser."""

    def __init__(
        self,
        scene: viser.SceneApi,
        root: str,
        kit: MachineKit,
        tint: Tint | None = None,
        *,
        skip: frozenset[str] = frozenset(),
    ) -> None:
        """Add the machine at zero joint positions; parts in `skip` are carried but not drawn."""
        self._skip = skip
        self._scene = scene
        self._root_path = root
        self._kit = kit
        self._tint: Tint | None = None
        self._joints = np.zeros(6)
        self._root = scene.add_frame(root, show_axes=False)
        self._frames = {
            part.name: scene.add_frame(
                root + part.path,
                show_axes=False,
                position=local_pose(part, self._joints).position_m,
                wxyz=local_pose(part, self._joints).quaternion_wxyz,
            )
            for part in kit.parts
        }
        self._draw(tint)

    def _draw(self, tint: Tint | None) -> None:
        self._tint = tint
        for part in self._kit.parts:
            mesh = self._kit.meshes.get(part.name)
            if mesh is None or part.name in self._skip:
                continue
            name = f"{self._root_path}{part.path}/skin"
            if tint is None:
                self._scene.add_glb(name, self._kit.glb[part.name], cast_shadow=True)
                continue
            vertices, faces = mesh.merged
            self._scene.add_mesh_simple(
                name,
                vertices,
                faces,
                color=tint.colour,
                opacity=tint.opacity_ratio,
                cast_shadow=False,
                receive_shadow=False,
            )

    def set_tint(self, tint: Tint | None) -> None:
        """Draw the machine in one translucent colour, or (None) in its own materials."""
        if tint != self._tint:
            self._draw(tint)

    @property
    def joints_rad_m(self) -> Array:
        """Joint positions as drawn, shape (6,)."""
        return self._joints

    def pose(self, joints_rad_m: Array) -> None:
        """Move to joint positions of shape (6,); sends only what changed."""
        moved = joints_rad_m != self._joints
        if not moved.any():
            return
        self._joints = np.array(joints_rad_m, dtype=np.float64)
        for part in self._kit.parts:
            if not isinstance(part, JointPart | CylinderPart) or not moved[part.joint_index]:
                continue
            pose = local_pose(part, self._joints)
            if isinstance(part, JointPart) and part.is_slide:
                self._frames[part.name].position = pose.position_m
            else:
                send_orientation(self._scene, self._root_path + part.path, pose.quaternion_wxyz)

    def show_load(self, is_held: bool) -> None:
        """Show or hide the load in the gripper."""
        self._frames[PAYLOAD].visible = is_held

    def set_visible(self, is_visible: bool) -> None:
        """Show or hide the machine."""
        self._root.visible = is_visible

    def remove(self) -> None:
        """Take the machine out of the scene."""
        self._root.remove()
