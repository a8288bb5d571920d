"""Tuned constants of the diagnosis of throws, each with its unit and meaning.

They were chosen on throws of virtual machines with known effects. Constants that follow from sensors, from
numerical steps or from the effect table are defined where they are used.
"""

# Evidence and priors
SLAB_SCALES_RATIO = (1.0, 0.35, 0.12)
"""The slab is a mixture of these multiples of the prior's width: effects come in all sizes."""
MIN_SLAB_OVER_SPIKE_RATIO = 4.0
"""Least ratio of slab to spike width; a narrower slab would be a second spike."""
MOST_SIDE_RATIO = 0.4
"""Largest slab width as a share of the bound on its side, for parameters whose bounds are not symmetric."""
PARTNER_LOG_PRIOR = -1.0
"""Log prior odds per pair of effects in a set: what an effect of the library does not model resembles
another."""
THIRD_LOG_PRIOR = -8.0
"""Additional log prior odds per library effect beyond the second."""
FORM_TEMPERATURE_RATIO = 8.0
"""Divisor of the log odds for the choice between sets of equally many effects; it calibrates the
probabilities."""
COUNT_TEMPERATURE_RATIO = 2.0
"""Divisor of the log odds for the choice of the number of effects; it calibrates the probabilities."""
GROUP_LOG_PRIOR = -6.0
"""Prior log odds of an effect: one effect in six data sets, among about seventy."""
NONSMOOTH_LOG_PRIOR = -8.0
"""Prior log odds of a nonsmooth effect. The position where a sticking joint rests is fitted to the
throws (`replay_drives`), a degree of freedom that other effects lack."""
SPIKE_WIDENING_RATIO = 1.1
"""Factor on the scatter, which was measured on a finite number of machines."""
DRIFT_LOG_PRIOR = -8.0
"""Prior log odds of a drift: rarer than a constant effect, and there are as many."""
UNMODELLED_LOG_PRIOR = -8.0
"""Prior log odds of an unmodelled effect: rarer than an effect of the library."""
JITTER_LOG_PRIOR = -5.0
"""Prior log odds of jitter."""
FOLLOWS_LOG_PRIOR = -3.0
"""Prior log odds of a spread that follows the swing, against jitter."""
JITTER_TREND_SD_S = 0.2
"""Prior standard deviation of mean, trend, and dependence on the standardised swing."""

# Model error of effects
MODEL_ERROR_RATIO = {"actuation": 0.2, "swing": 0.05, "flight": 0.05}
"""Discrepancy of a real effect from the library's model by stage, as a share of the twin's deviation."""
SHARED_ERROR_RATIO = {"actuation": 0.1, "swing": 0.05}
"""Share of an effect's signal that may look like another named effect, the same in all throws. It is
less than `MODEL_ERROR_RATIO`, since most of a model error looks like no other effect."""
EXCITATION_RATIO = 0.2
"""Discrepancy at other joints as a share of the change that stiction or backlash makes at its own joint."""
JUMP_SD = 4.0
"""Limit of a whitened sample in a block with nonsmooth motion: a joint that breaks loose jumps within a
tick."""
FORM_EVIDENCE_RATIO = 0.02
"""Share of the log evidence of the effects beside an unmodelled effect that is attributed to their model
error."""
SIZE_ERROR_RATIO = 0.09
"""Standard deviation of the model error of a fitted parameter, as a share of its value. It makes 90 %
intervals hold at their nominal rate."""

# Machines of another type
LEAST_MISFIT_RATIO = 0.5
"""Least factor: no twin is closer to a machine, however quiet its sensors. Simulation steps of 10 ms
limit it."""
CLEAR_LOG_POWER = 0.7
"""Excess log power from which a misfit is significant; levels of healthy sets of the type scatter by 0.1
to 0.2."""
LAG_RATIO = 0.1
"""Deviation of another machine's drive lag, as a share of the lag."""
LEAST_SHAPE_S = 0.015
"""Joint deviation of dead time and lag with opposite signs, s: another valve has another order of its
response. The mean delay stays."""
CLOCK_SD_S = 0.006
"""Deviation of a sensor's latency on another machine, s: it has other filters and buses."""
COMMON_CLOCK_SD_S = 0.008
"""Common latency of all sensors with commands earlier by as much, s. No log shows it, but noise in
measured joints acts alike, since a later twin is a smoother one."""
LEAST_VISCOUS_PER_S = 0.015
"""Deviation of the viscous friction of another machine's passive joints, 1/s."""
LEAST_DEAD_BAND_RATIO = 0.008
"""Deviation of another valve's overlap, as a share of full command."""
LEVEL_SD = 0.06
"""Spread of the log residual power between joints or axes of a machine of another type."""
DRIVE_RATIOS = (1.0, 0.5, 0.25)
"""Deviations of another machine's drives relative to the type's that are compared."""

# Generation of candidates
RESIDUAL_JOINT_SD = 3.0
"""Residual power of a joint, in standard deviations of healthy sets, from which all effects at the joint
are examined."""
RESIDUAL_JOINT_COUNT = 2
"""Largest number of such joints."""
RESIDUAL_JOINT_RATIO = 0.5
"""Joints with at least this share of the largest residual power are examined, too: a neighbour may
excite it."""
CLEAR_LOG_ODDS = 10.0
"""Log odds of an effect at "no effect" from which its joint is examined."""
FAR_RATIO = 3.0
"""Starting size of effects that slopes do not show, as a multiple of their typical size."""
BETWEEN_RATIO = (1.75,)
"""Further starting sizes, as multiples of the typical size."""
STICTION_BETWEEN_RATIO = (1.35, 1.75, 2.15, 2.55)
"""Further starting sizes of stiction, whose evidence has narrow maxima, as multiples of the typical size."""
UNMODELLED_COUNT = 5
"""Sets with an unmodelled effect that are weighed."""
LEAST_OWN_LOG_EVIDENCE = 4.0
"""Least log evidence of an unmodelled effect from what no named parameter explains of it."""
SINGLE_COUNT = 6
"""Single effects that are evaluated further."""
SUBSET_COUNT = 3
"""Sets whose members alone, or whose subsets, are evaluated."""
PARTNER_SIZE_COUNT = 2
"""Starting sizes of a second effect."""
SMALLER_RATIO = ((1.0, 0.6), (0.6, 1.0), (0.6, 0.6))
"""Factors on a dead band in both directions: its possible size beside another effect at its joint."""
PARTNER_COUNT = 4
"""Pairs with an effect that slopes do not show that are evaluated further."""
MARGIN_LOG_ODDS = 3.0
"""Log odds within which the extrapolated evidence of an extended set must come to the best set."""
STALE_MARGIN_LOG_ODDS = 10.0
"""The same where the slopes of the last effect are those at no effect (`sensitivities.relinearise`)."""
PREVIEW_COUNT = 6
"""Fewest throws of a preview; smaller sets are previewed with all throws."""

# Refinement and comparison
COARSE_STEP_RATIO = (1.5, 1.2)
"""Step factors of the coarse line search over sizes."""
FINE_STEP_RATIO = (1.1, 1.05)
"""Step factors of the fine line search over sizes."""
LEAST_OVER_SCATTER_RATIO = 1.5
"""Least size of an effect as a multiple of the scatter of healthy machines."""
CLOSE_LOG_ODDS = 300.0
"""Log odds behind the best set within which the machine's own scatter is simulated."""
RIVAL_LOG_ODDS = 40.0
"""Log odds behind the best set within which the machine's own scatter is simulated a second time."""
MOST_STEPS_COUNT = 3
"""Largest number of iterations of a set's sizes."""
PART_LOG_ODDS = 20.0
"""Largest gain of a subset in the linearisation of the whole set. Slopes there extrapolate badly to zero
where a joint stands, or is late by as much as its motion lasts."""
NEARBY_SD = 2.0
"""Posterior standard deviations within which a machine's scatter counts as being at the simulated sizes."""
JUMP_LOG_ODDS = 10.0
"""Log odds over no effect that a candidate with jumps must have in its own linearisation."""
LEAST_INFORMATION_RATIO = 1e-6
"""Least information about a size, as a share of the precision of its wide prior."""
GROWTH = ((3, 6), (2, 3))
"""For pairs, then triples: number of smaller sets to extend, and of extended sets to evaluate."""
PAIRED_COUNT = 2
"""Single effects that are paired with effects that slopes do not show."""
WEIGHED_COUNT = 5
"""Sets that are weighed in the end."""

# Unknown effects and claims
UNKNOWN_LEVEL_SD = 5.5
UNKNOWN_WIDTH_SD = 1.0
"""Residual power, in standard deviations of healthy sets, at which "unknown" has even odds, and the
width of the logistic."""
QUIET_LEVEL_SD = 4.5
QUIET_WIDTH_SD = 0.5
"""The same where no effect is best: then no model error of an effect adds to the residual power."""
CROWDED_LEVEL_SD = 3.4
CROWDED_WIDTH_SD = 0.4
"""The same at a joint where the best set has two effects or more, which together take up most of an
unknown effect."""
STICKING_LEVEL_SD = 2.5
"""Additional standard deviations at a joint with stiction: it oscillates as it breaks loose, and the
twin's does not."""
FORM_LEVEL_SD = 1.0
FORM_LOG_EVIDENCE = 1000.0
"""Additional `FORM_LEVEL_SD` standard deviations for this log evidence of the best set over none, twice
at most: the model error of a large effect adds to the residual power."""
FORM_LEFT_RATIO = 0.1
"""Share of a block's excess power over healthy machines below which it is model error of the best set."""
SURE_PROBABILITY = 0.8
"""Probability from which a cause is claimed alone."""
RIVAL_PROBABILITY = 0.15
"""Probability from which another cause is not ruled out."""
DOUBT_PROBABILITY = 0.15
"""Probability of "none" from which no effect is claimed."""
QUIET_SD = 3.0
"""Residual power of an axis without an effect, in standard deviations of healthy sets."""
LEAST_GAIN_RATIO = 0.05
"""Least share of the removable gap that an explanation closes."""
PLAIN_PROBABILITY = 0.01
"""Probability of "none" below which a gain must be possible, and need not be significant."""
SOME_PROBABILITY = 0.05
"""Probability of "none" from which the interval of the gain decides (`MOST_LOSS_RATIO`)."""
MOST_LOSS_RATIO = 0.1
"""Where "none" has at least `SOME_PROBABILITY`, an effect is not claimed if the interval of its gain
ends below `LEAST_GAIN_RATIO` or begins below minus this share. Where "none" has at least
`PLAIN_PROBABILITY`, an effect is not claimed if its mean gain is below `LEAST_GAIN_RATIO`."""
LEAST_GAP_RATIO = 0.02
"""The removable gap counts as at least this share of the gap."""
CLEAR_RATIO = 1.6
"""An impact gap of more than this multiple of a healthy machine's is a measure of an effect."""
