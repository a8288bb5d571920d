"""Generate machine/spec.json from machine/m545.xml; a missing value is an error."""

from pathlib import Path
from typing import Any

import mujoco

from machine.conventions import ACTIVE_JOINTS
from machine.spec import MJCF_PATH, SPEC_PATH, MachineSpec


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, 9)
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(item) for item in value]
    return value


def _collision_shapes(model: mujoco.MjModel) -> list[dict[str, Any]]:
    kinds = {
        int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsule",
        int(mujoco.mjtGeom.mjGEOM_SPHERE): "sphere",
        int(mujoco.mjtGeom.mjGEOM_BOX): "box",
    }
    return [
        {
            "name": model.geom(i).name,
            "body": model.body(int(model.geom_bodyid[i])).name,
            "kind": kinds[int(model.geom_type[i])],
            "size_m": [float(v) for v in model.geom_size[i]],
            "position_m": [float(v) for v in model.geom_pos[i]],
            "quaternion_wxyz_ratio": [float(v) for v in model.geom_quat[i]],
        }
        for i in range(model.ngeom)
        if (model.geom_contype[i] or model.geom_conaffinity[i]) and int(model.geom_type[i]) in kinds
    ]


class _Source:
    """Reads spec values from the compiled MJCF."""

    def __init__(self, path: Path) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(path))

    def numbers(self, name: str) -> list[float]:
        return [float(v) for v in self.model.numeric(name).data]

    def number(self, name: str) -> float:
        return self.numbers(name)[0]

    def limit(self, joint: str, what: str, unit: str) -> list[float]:
        length = "m" if joint == "telescope" else "rad"
        return self.numbers(f"{joint}_{what}_limit_{length}_{unit}")

    def body(self, name: str) -> Any:
        return self.model.body(name)


def _geometry(source: _Source) -> dict[str, Any]:
    slew_frame = source.body("chassis").pos + source.body("upper").pos
    return {
        "slew_frame_height_m": float(slew_frame[2]),
        "boom_pivot_m": [float(v) for v in source.body("boom").pos],
        "boom_length_m": float(source.body("dipper").pos[0]),
        "telescope_axis_offset_m": float(source.body("telescope").pos[0]),
        "dipper_to_telescope_m": -float(source.body("telescope").pos[2]),
        "telescope_to_pin_m": -float(source.body("hanger").pos[2]),
        "pitch_to_roll_m": -float(source.body("gripper").pos[2]),
        "roll_to_grip_centre_m": -float(source.model.site("grip_centre").pos[2]),
    }


def _limits(source: _Source) -> dict[str, Any]:
    joints = [source.model.joint(name) for name in ACTIVE_JOINTS]
    ranges = [[float(v) for v in j.range] if j.limited[0] else [None, None] for j in joints]
    speeds = [source.limit(name, "speed", "per_s") for name in ACTIVE_JOINTS]
    return {
        "position_min_rad_m": [r[0] for r in ranges],
        "position_max_rad_m": [r[1] for r in ranges],
        "speed_positive_rad_m_per_s": [s[0] for s in speeds],
        "speed_negative_rad_m_per_s": [s[1] for s in speeds],
        "acceleration_rad_m_per_s2": [
            source.limit(name, "acceleration", "per_s2")[0] for name in ACTIVE_JOINTS
        ],
        "swing_rad": source.number("swing_limit_rad"),
    }


def _cylinder(source: _Source, name: str) -> dict[str, Any]:
    bore, rod = source.numbers(f"{name}_cylinder_bore_rod_m")
    return {
        "bore_m": bore,
        "rod_m": rod,
        "base_xz_m": source.numbers(f"{name}_cylinder_base_xz_m"),
        "rod_xz_m": source.numbers(f"{name}_cylinder_rod_xz_m"),
    }


def _hydraulics(source: _Source) -> dict[str, Any]:
    telescope_bore, telescope_rod = source.numbers("telescope_cylinder_bore_rod_m")
    return {
        "pump_flow_m3_per_s": source.number("pump_flow_m3_per_s"),
        "supply_pressure_pa": source.number("supply_pressure_pa"),
        "boom_cylinder": _cylinder(source, "boom"),
        "dipper_cylinder": _cylinder(source, "dipper"),
        "telescope_bore_m": telescope_bore,
        "telescope_rod_m": telescope_rod,
        "slew_displacement_m3_per_rad": source.number("slew_displacement_m3_per_rad"),
        "valve_dead_band_ratio": source.number("valve_dead_band_ratio"),
    }


def _passive(source: _Source) -> dict[str, Any]:
    tree: dict[str, Any] = {
        "viscous_friction_per_s": source.number("passive_viscous_friction_per_s"),
        "coulomb_friction_rad_per_s2": source.number("passive_coulomb_friction_rad_per_s2"),
    }
    for name in ("hanger", "gripper"):
        body = source.body(name)
        tree[f"{name}_mass_kg"] = float(body.mass[0])
        tree[f"{name}_com_m"] = -float(body.ipos[2])
        tree[f"{name}_inertia_kg_m2"] = [float(v) for v in body.inertia]
    return tree


def build_spec(mjcf_path: Path = MJCF_PATH) -> MachineSpec:
    """Spec with all constants read from the compiled MJCF.

    Raises:
        KeyError: a numeric, body or joint is missing in the MJCF.
    """
    source = _Source(mjcf_path)
    number = source.number
    tree: dict[str, Any] = {
        "model_name": "m545",
        "geometry": _geometry(source),
        "limits": _limits(source),
        "hydraulics": _hydraulics(source),
        "response": {
            "dead_time_s": [number("slew_dead_time_s")] + [number("arm_dead_time_s")] * 3,
            "lag_s": [number("slew_lag_s")] + [number("arm_lag_s")] * 3,
        },
        "release": {
            "delay_s": number("release_delay_s"),
            "delay_sd_s": number("release_delay_sd_s"),
        },
        "passive": _passive(source),
        "ball": {
            "mass_kg": number("ball_mass_kg"),
            "radius_m": number("ball_radius_m"),
            "drag_coefficient_ratio": number("ball_drag_coefficient_ratio"),
            "air_density_kg_per_m3": number("air_density_kg_per_m3"),
        },
        "static_reach_m": number("static_reach_m"),
        "collision_shapes": _collision_shapes(source.model),
    }
    return MachineSpec.model_validate(_rounded(tree))


def write_spec(path: Path = SPEC_PATH) -> None:
    """Write the spec as indented JSON with a newline at its end, which keeps its diff readable."""
    path.write_text(build_spec().model_dump_json(indent=2) + "\n", encoding="utf-8")
