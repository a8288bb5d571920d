"""Configurations of a training: task, randomisation, reward and learner.

A task is a function that returns a configuration. The resolved configuration is saved in the policy's card.
Sources: "paper" is *Dynamic Throwing with Robotic Material Handling Machines*; docs/paper_items.md maps its
items to symbols.
"""

from dataclasses import dataclass, field, replace
from typing import Literal

from machine.conventions import Mode

Four = tuple[float, float, float, float]
Range = tuple[float, float]


@dataclass(frozen=True)
class ResponseConfig:
    """Closed-loop velocity response of the active joints, drawn once per episode, in joint order.

    Reference -> dead time -> first-order lag -> second-order lag -> joint velocity, under the runtime's
    velocity controller; boom and dipper react on each other. Ranges: around the responses fitted to
    recorded throws of eight virtual machines (docs/training.md).
    """

    dead_time_min_s: Four = (0.01, 0.07, 0.03, 0.03)
    """Shortest dead time, valve and pressure build-up together."""
    dead_time_max_s: Four = (0.145, 0.155, 0.09, 0.08)
    """Longest dead time."""
    lag_min_s: Four = (0.28, 0.001, 0.001, 0.001)
    """Shortest first-order lag."""
    lag_max_s: Four = (0.40, 0.001, 0.001, 0.001)
    """Longest first-order lag."""
    natural_frequency_min_rad_per_s: Four = (11.3, 17.0, 18.0, 24.0)
    """Lowest natural frequency of the second-order lag."""
    natural_frequency_max_rad_per_s: Four = (14.8, 25.0, 38.0, 50.0)
    """Highest natural frequency."""
    damping_min_ratio: Four = (0.09, 0.40, 0.45, 0.90)
    """Smallest damping ratio."""
    damping_max_ratio: Four = (0.26, 1.4, 1.3, 2.0)
    """Largest damping ratio."""
    gain_positive_min_ratio: Four = (0.97, 0.88, 0.92, 0.965)
    """Smallest steady gain from a positive reference to velocity."""
    gain_positive_max_ratio: Four = (1.03, 1.00, 0.975, 1.01)
    """Largest steady gain of positive references."""
    gain_negative_min_ratio: Four = (0.97, 0.98, 0.98, 0.88)
    """Smallest steady gain of negative references."""
    gain_negative_max_ratio: Four = (1.03, 1.08, 1.05, 1.13)
    """Largest steady gain of negative references."""
    disturbance_sd_rad_m_per_s: Four = (0.0196, 0.0159, 0.0232, 0.0078)
    """Stationary standard deviation of the correlated velocity disturbance (paper, section III-A: velocity
    command randomisation): the residual of the fitted responses for boom, dipper and telescope, two thirds
    of it for the slew, whose residual is mostly ringing."""
    disturbance_correlation_s: Four = (0.35, 0.10, 0.15, 0.12)
    """Correlation time of that disturbance."""
    boom_from_dipper_ratio: Range = (0.4, 0.7)
    """Share of the dipper's acceleration that its reaction takes from the boom's."""
    dipper_from_boom_ratio: Range = (0.3, 0.9)
    """Share of the boom's acceleration that its reaction takes from the dipper's."""


def widened(response: ResponseConfig, factor_ratio: float) -> ResponseConfig:
    """The same response with every range but the first-order lag's stretched about its middle.

    Wider randomisation makes a policy's accuracy more uniform over machines. No value
    falls below 0.001.
    """
    stretched: dict[str, Four] = {}
    for name in ("dead_time_{}_s", "natural_frequency_{}_rad_per_s", "damping_{}_ratio",
                 "gain_positive_{}_ratio", "gain_negative_{}_ratio"):  # fmt: skip
        low: Four = getattr(response, name.format("min"))
        high: Four = getattr(response, name.format("max"))
        middle = [0.5 * (a + b) for a, b in zip(low, high, strict=True)]
        half = [0.5 * (b - a) * factor_ratio for a, b in zip(low, high, strict=True)]
        pairs = list(zip(middle, half, strict=True))
        stretched[name.format("min")] = _four([max(m - h, 0.001) for m, h in pairs])
        stretched[name.format("max")] = _four([m + h for m, h in pairs])
    return replace(response, **stretched)


def _four(values: list[float]) -> Four:
    slew, boom, dipper, telescope = values
    return slew, boom, dipper, telescope


@dataclass(frozen=True)
class PassiveConfig:
    """Randomisation of the free joints, the load and the release."""

    friction_scale_ratio: Range = (0.5, 1.5)
    """Factor on both friction terms of the paper's equation 3."""
    gripper_com_error_m: Range = (-0.075, 0.075)
    """Error of the distance from roll axis to the gripper's centre of mass."""
    gripper_inertia_scale_ratio: Range = (0.85, 1.15)
    """Factor on the gripper's inertia about its centre of mass."""
    gripper_mass_scale_ratio: Range = (0.87, 1.13)
    """Factor on the gripper's mass."""
    telescope_to_pin_error_m: Range = (-0.03, 0.03)
    """Error of the length from telescope frame to tool pin."""
    pitch_to_roll_error_m: Range = (-0.02, 0.02)
    """Error of the distance between the free axes."""
    roll_to_grip_error_m: Range = (-0.03, 0.03)
    """Error of the distance from roll axis to grip centre."""
    grasp_error_m: float = 0.02
    """Largest distance of the held load from the grip centre, any direction."""
    slip_sd_m_per_s: float = 0.015
    """Standard deviation of the velocity that the opening claws add to the load, each axis."""
    payload_mass_kg: Range = (0.567, 0.650)
    """Mass of the ball (FIBA size 7)."""
    drag_scale_ratio: Range = (0.85, 1.15)
    """Factor on the ball's drag."""
    release_delay_mean_s: Range = (0.253, 0.263)
    """Mean opening delay of one machine (paper: 258 ms)."""
    release_delay_sd_s: float = 0.015
    """Standard deviation of single releases about that mean (paper, section III-F)."""
    start_swing_sd_rad: Range = (0.02, 0.02)
    """Deviation of pitch and roll from plumb at the start."""
    start_swing_rate_sd_rad_per_s: Range = (0.03, 0.03)
    """Rate of pitch and roll at the start."""


@dataclass(frozen=True)
class SensorConfig:
    """Errors of the observation."""

    position_noise_sd_rad_m: Four = (0.002, 0.002, 0.002, 0.002)
    """White noise of the active joints' positions."""
    velocity_noise_sd_rad_m_per_s: Four = (0.01, 0.01, 0.01, 0.01)
    """White noise of the active joints' velocities."""
    swing_noise_sd_rad: float = 0.005
    """White noise of the estimated passive angles."""
    swing_bias_sd_rad: float = 0.009
    """Standard deviation of the passive angles' bias, constant over an episode; 10 mrad with the noise."""
    swing_rate_noise_sd_rad_per_s: float = 0.02
    """White noise of the estimated passive rates."""
    latency_s: Range = (0.005, 0.02)
    """Age of the observed joint state; one control tick on average."""


@dataclass(frozen=True)
class RewardConfig:
    """Weights of the reward: shipped terms (``impact``) or the paper's (``paper``, section III-D).

    ``impact``: progress of the predicted impact (landing point of a release now), action penalties, and a
    landing reward that is steep near the target. ``paper``: progress of the ball towards the target,
    closeness, action penalties, and exp(-b2 err^2) when the ball lands.
    """

    kind: Literal["impact", "paper"] = "impact"
    """Which terms."""
    progress_ratio: float = 1.0
    """impact: reward per metre of progress."""
    landing_height_ratio: tuple[float, float, float] = (2.0, 4.0, 4.0)
    """impact: heights of the landing reward's Gaussians."""
    landing_width_m: tuple[float, float, float] = (1.0, 0.25, 0.08)
    """impact: their widths."""
    landing_linear_ratio: float = 0.5
    """impact: loss per metre of landing error."""
    landing_linear_limit_m: float = 4.0
    """impact: landing error from which the loss no longer grows."""
    failure_ratio: float = 5.0
    """Loss at a collision, a limit or no release."""
    action_difference_ratio: float = 0.02
    """Loss per squared change of the action (paper: c3)."""
    action_ratio: float = 0.002
    """Loss per squared action (paper: c4, only after the release)."""
    hurry_per_s_ratio: float = 3.5
    """impact, with a pace: loss per second until the release, times the square of the pace. For comparison,
    discounting takes 0.6 per second from a landing on target."""
    hurry_from_ratio: Range = (0.35, 0.65)
    """Shares of the training between which that loss rises from zero to its full value. Charged from the
    start it leads to releases before the load has swung far enough."""
    care_action_ratio: float = 0.02
    """impact, with a pace: loss per squared action while the load is held, times 1 - pace: machines differ
    less in their response to small commands. For comparison, a centimetre of landing error costs 0.4."""
    care_release_ratio: float = 0.03
    """impact, with a pace: loss per squared m/s of the released load, times 1 - pace."""
    approach_ratio: float = 1.0
    """paper: c1, weight of r_delta_err."""
    closeness_ratio: float = 0.02
    """paper: c2, weight of r_err_3D."""
    closeness_per_m2_ratio: float = 0.5
    """paper: b1."""
    landing_per_m2_ratio: float = 4.0
    """paper: b2 of the landing reward exp(-b2 err^2)."""
    landing_paper_ratio: float = 5.0
    """paper: weight of that landing reward."""


@dataclass(frozen=True)
class EpisodeConfig:
    """Start, target and end of an episode."""

    target_range_m: Range
    """Distance of targets from the slew axis."""
    target_height_m: Range = (0.0, 0.0)
    """Height of the target plane (paper: ground level)."""
    ground_share_ratio: float = 0.0
    """Share of the targets at ground level; the others are drawn from the range of heights."""
    reach_at_height_m: tuple[tuple[float, float], ...] = ()
    """Pairs of height and largest range there, heights increasing, interpolated linearly; empty: the same
    range at every height."""
    aim_margin_m: float = 0.0
    """How far beyond the requested ranges targets are drawn: a registration moves the aim point past targets
    that a machine falls short of."""
    pace_ratio: Range | None = None
    """Range of the pace, drawn once per episode; it is observed and weighs the reward. None: no pace."""
    start_count: int = 65536
    """Start poses in the table, which is drawn on the host."""
    time_limit_s: float = 7.0
    """An episode without a release ends then."""
    swing_limit_rad: float = 1.30
    """Absolute swing that ends an episode before the release; the machine's limit is 1.35 rad."""
    roll_limit_rad: float = 1.1
    """Absolute roll that ends an episode."""
    joint_limit_margin_rad_m: float = 0.03
    """Distance from a joint limit that ends an episode before the release."""
    clearance_m: float = 0.12
    """Distance of the gripper from ground, arm and machine that counts as a collision."""
    override_probability_ratio: float = 0.0
    """Probability per step that the release is forced near the target (paper: 5 %, section III-C). Zero in
    the shipped tasks: with it policies rush past near targets."""
    override_distance_m: float = 2.0
    """Distance of the predicted impact from the target below which the release may be forced."""
    override_speed_m_per_s: float = 1.5
    """Grip-centre speed below which the release may be forced."""
    after_release: Literal["settle", "policy"] = "settle"
    """What drives the joints after the release: the runtime's settle motion for `settle_s`, or the policy
    until the load lands (paper)."""
    settle_s: float = 1.4
    """Time after the release that belongs to the episode, in which the gripper swings back."""
    settle_delay_s: Range = (0.02, 0.06)
    """Time from the release to the settle motion: load switch and control ticks."""
    settle_swing_limit_rad: float = 1.6
    """Absolute swing that ends an episode after the release."""


@dataclass(frozen=True)
class TaskConfig:
    """One training task."""

    mode: Mode
    """2D: within the arm plane; 3D: with the slew."""
    episode: EpisodeConfig
    """Starts, targets and ends of episodes."""
    response: ResponseConfig = field(default_factory=ResponseConfig)
    """The active joints."""
    passive: PassiveConfig = field(default_factory=PassiveConfig)
    """The free joints, load and release."""
    sensor: SensorConfig = field(default_factory=SensorConfig)
    """Errors of the observation."""
    reward: RewardConfig = field(default_factory=RewardConfig)
    """The reward."""


@dataclass(frozen=True)
class PpoConfig:
    """Proximal policy optimisation (Schulman 2017) with generalised advantage estimation."""

    environment_count: int = 8192
    """Parallel environments (paper)."""
    step_count: int = 32
    """Control steps an iteration (paper)."""
    iteration_count: int = 4000
    """Iterations (paper)."""
    hard_start_ratio: float = 0.0
    """Share of the episodes whose start is drawn in proportion to its miss (training.start_sampling)."""
    epoch_count: int = 5
    """Passes over a batch."""
    minibatch_count: int = 4
    """Parts of a batch, split along the environments."""
    hidden_count: tuple[int, ...] = (256, 128)
    """Units of the hidden layers, actor and critic (paper)."""
    discount_ratio: float = 0.995
    """Gamma. At 0.99 a second of waiting costs a landing on target 1.2 of its reward of 10, and 3D throws are
    released while the cabin still slews. 0.998 allows for extending a retracted telescope first."""
    trace_ratio: float = 0.95
    """Lambda of the advantage estimate."""
    clip_ratio: float = 0.2
    """Clipping of the probability ratio."""
    entropy_ratio: float = 0.002
    """Weight of the entropy."""
    value_ratio: float = 0.5
    """Weight of the value loss."""
    learning_rate_ratio: float = 1e-3
    """First learning rate; adapted to the divergence from then on."""
    learning_rate_range_ratio: Range = (1e-5, 3e-3)
    """Bounds of the learning rate."""
    divergence_ratio: Range = (0.005, 0.02)
    """Below the first the learning rate grows, above the second it shrinks."""
    divergence_shrinks_from_ratio: float = 0.7
    """Share of the training from which both bounds shrink, linearly on a logarithmic scale."""
    divergence_last_ratio: float = 0.4
    """Share of the bounds at the end of the training: small last steps, little noise in the exported
    weights. Much smaller bounds stop the learning, since rounding to bfloat16 alone causes a divergence of
    0.003."""
    hidden_type: Literal["float32", "bfloat16"] = "bfloat16"
    """Type of the hidden layers' outputs during training; exported policies use float32."""
    gradient_norm_ratio: float = 1.0
    """Bound of the norms of the actor's and of the critic's gradient, clipped separately."""
    log_deviation_start_ratio: float = -0.5
    """First log standard deviation of the actions."""
    log_deviation_floor_ratio: Range = (-1.5, -3.0)
    """Floor of the log standard deviation at the start and from two thirds of the training on."""
