import numpy as np

from machine.conventions import Mode
from machine.kinematics import pin_in_plane
from machine.spec import load_spec
from machine.starts import sample_starts
from runtime.control.arm_motion import ArmMotion
from tests.runtime.samples import at_rest

SPEC = load_spec()


def test_pin_motion_is_the_derivative_of_the_pin_s_position():
    rng = np.random.default_rng(0)
    pose = sample_starts(SPEC, Mode.SPATIAL, np.tile([9.0, 0.0, 0.0], (40, 1)), rng)
    rate = np.zeros_like(pose)
    rate[:, :4] = rng.normal(0.0, 0.4, (40, 4))
    sample = at_rest(40, pose=pose, joint_velocity_rad_m_per_s=rate[:, :4])
    arm = ArmMotion.of(SPEC, sample)
    step = 1e-6
    change = (pin_in_plane(SPEC, pose + step * rate) - pin_in_plane(SPEC, pose - step * rate)) / (
        2.0 * step
    )
    assert np.allclose(arm.velocity_rad_m_per_s[:2].T, change, atol=1e-8)
    assert np.array_equal(arm.velocity_rad_m_per_s[2], rate[:, 0])
    assert np.allclose(arm.radius_m, pin_in_plane(SPEC, pose)[:, 0])


def test_arms_of_dipper_and_telescope():
    pose = sample_starts(
        SPEC, Mode.SPATIAL, np.tile([9.0, 0.0, 0.0], (20, 1)), np.random.default_rng(1)
    )
    for joint, field in ((2, "dipper_arm_m"), (3, "telescope_arm_ratio")):
        rate = np.zeros((20, 4))
        rate[:, joint] = 1.0
        arm = ArmMotion.of(SPEC, at_rest(20, pose=pose, joint_velocity_rad_m_per_s=rate))
        assert np.allclose(getattr(arm, field), arm.velocity_rad_m_per_s[0])
