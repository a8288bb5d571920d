"""Generate machine/spec.json from machine/m545.xml; a value the MJCF lacks is an error."""

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


def build_spec(mjcf_path: Path = MJCF_PATH) -> MachineSpec:
    """Compile the MJCF and read every constant of the spec from the compiled model.

    Raises:
        KeyError: a numeric, body or joint that the spec needs is missing in the MJCF.
    """
    model = mujoco.MjModel.from_xml_path(str(mjcf_path))

    def numbers(name: str) -> list[float]:
        return [float(v) for v in model.numeric(name).data]

    def number(name: str) -> float:
        return numbers(name)[0]

    def speeds(direction: int) -> list[float]:
        return [
            numbers(f"{j}_speed_limit_{'m' if j == 'telescope' else 'rad'}_per_s")[direction]
            for j in ACTIVE_JOINTS
        ]

    def cylinder(name: str) -> dict[str, Any]:
        bore, rod = numbers(f"{name}_cylinder_bore_rod_m")
        return {
            "bore_m": bore,
            "rod_m": rod,
            "base_xz_m": numbers(f"{name}_cylinder_base_xz_m"),
            "rod_xz_m": numbers(f"{name}_cylinder_rod_xz_m"),
        }

    ranges = [
        [float(v) for v in model.joint(j).range] if model.joint(j).limited[0] else [None, None]
        for j in ACTIVE_JOINTS
    ]
    telescope_bore, telescope_rod = numbers("telescope_cylinder_bore_rod_m")
    slew_frame = model.body("chassis").pos + model.body("upper").pos
    tree: dict[str, Any] = {
        "model_name": "m545",
        "geometry": {
            "slew_frame_height_m": float(slew_frame[2]),
            "boom_pivot_m": [float(v) for v in model.body("boom").pos],
            "boom_length_m": float(model.body("dipper").pos[0]),
            "telescope_axis_offset_m": float(model.body("telescope").pos[0]),
            "dipper_to_telescope_m": -float(model.body("telescope").pos[2]),
            "telescope_to_pin_m": -float(model.body("hanger").pos[2]),
            "pitch_to_roll_m": -float(model.body("gripper").pos[2]),
            "roll_to_grip_centre_m": -float(model.site("grip_centre").pos[2]),
        },
        "limits": {
            "position_min_rad_m": [r[0] for r in ranges],
            "position_max_rad_m": [r[1] for r in ranges],
            "speed_positive_rad_m_per_s": speeds(0),
            "speed_negative_rad_m_per_s": speeds(1),
            "acceleration_rad_m_per_s2": [
                number(f"{j}_acceleration_limit_{'m' if j == 'telescope' else 'rad'}_per_s2")
                for j in ACTIVE_JOINTS
            ],
            "swing_rad": number("swing_limit_rad"),
        },
        "hydraulics": {
            "pump_flow_m3_per_s": number("pump_flow_m3_per_s"),
            "supply_pressure_pa": number("supply_pressure_pa"),
            "boom_cylinder": cylinder("boom"),
            "dipper_cylinder": cylinder("dipper"),
            "telescope_bore_m": telescope_bore,
            "telescope_rod_m": telescope_rod,
            "slew_displacement_m3_per_rad": number("slew_displacement_m3_per_rad"),
            "valve_dead_band_ratio": number("valve_dead_band_ratio"),
        },
        "response": {
            "dead_time_s": [number("slew_dead_time_s")] + [number("arm_dead_time_s")] * 3,
            "lag_s": [number("slew_lag_s")] + [number("arm_lag_s")] * 3,
        },
        "release": {
            "delay_s": number("release_delay_s"),
            "delay_sd_s": number("release_delay_sd_s"),
        },
        "passive": {
            "viscous_friction_per_s": number("passive_viscous_friction_per_s"),
            "coulomb_friction_rad_per_s2": number("passive_coulomb_friction_rad_per_s2"),
            "hanger_mass_kg": float(model.body("hanger").mass[0]),
            "hanger_com_m": -float(model.body("hanger").ipos[2]),
            "hanger_inertia_kg_m2": [float(v) for v in model.body("hanger").inertia],
            "gripper_mass_kg": float(model.body("gripper").mass[0]),
            "gripper_com_m": -float(model.body("gripper").ipos[2]),
            "gripper_inertia_kg_m2": [float(v) for v in model.body("gripper").inertia],
        },
        "ball": {
            "mass_kg": number("ball_mass_kg"),
            "radius_m": number("ball_radius_m"),
            "drag_coefficient_ratio": number("ball_drag_coefficient_ratio"),
            "air_density_kg_per_m3": number("air_density_kg_per_m3"),
        },
        "static_reach_m": number("static_reach_m"),
        "collision_shapes": _collision_shapes(model),
    }
    return MachineSpec.model_validate(_rounded(tree))


def write_spec(path: Path = SPEC_PATH) -> None:
    """Write the spec as indented JSON with a newline at its end, so that its diff reads well."""
    path.write_text(build_spec().model_dump_json(indent=2) + "\n", encoding="utf-8")
