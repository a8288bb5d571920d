"""Tuned constants of the diagnosis of throws, each with its unit and meaning.

They were chosen on throws of virtual machines with known effects. Constants that follow from sensors, from
numerical steps or from the effect table are defined where they are used.
"""

# Evidence and priors
SLAB_SCALES_RATIO = (1.0, 0.35, 0.12)
"""The slab is a mixture of these multiples of the prior's width: effects come in all sizes."""
GROUP_LOG_PRIOR = -6.0
"""Prior log odds of an effect: one effect in six data sets, among about seventy."""
RARE_LOG_PRIOR = -8.0
"""Prior log odds of what is rarer than a constant effect of the library: a drift, of which there are as many;
an unmodelled effect; a nonsmooth one, since the position where a sticking joint rests is fitted to the throws
(`replay_drives`), a degree of freedom that other effects lack."""
SCATTER_WIDENING_RATIO = 1.1
"""Factor on the scatter, which was measured on a finite number of machines."""
JITTER_LOG_PRIOR = -5.0
"""Prior log odds of jitter."""
FOLLOWS_LOG_PRIOR = -3.0
"""Prior log odds of a spread that follows the swing, against jitter."""
JITTER_TREND_SD_S = 0.2
"""Prior standard deviation of mean, trend, and dependence on the standardised swing."""

# Form error of effects
FORM_ERROR_RATIO = 0.03
"""Form error of effects: share of a channel's misfit that says nothing about which effect it is, and that a
set of effects may leave of what it explains."""
SIZE_ERROR_RATIO = 0.09
"""Standard deviation of the model error of a fitted parameter, as a share of its value. It makes 90 %
intervals hold at their nominal rate."""

# Search for sets of effects
FURTHER_LOG_PRIOR = -3.0
"""Additional log prior odds of each effect beside the first."""
GRID_RATIO = (0.8, 1.8)
"""Sizes at which single effects are simulated, as multiples of the prior's width."""
EXTENSION_COUNT = 8
"""Further effects that are tried beside a set, by their slopes."""
FINAL_COUNT = 6
"""Sets that are compared with their healthy deviations simulated; the parts of the best two beside them."""
BEAM = ((4, 8), (3, 6))
"""For pairs, then triples: number of smaller sets to extend, and of extended sets to refine."""
SINGLE_COUNT = 12
"""Single effects that are evaluated further."""
PREVIEW_COUNT = 6
"""Fewest throws of a preview; smaller sets are previewed with all throws."""

# Unknown effects and claims
UNKNOWN_LEVEL_SD = 5.0
"""Power beyond healthy throws, in standard deviations of it between days, that is not unknown."""
UNKNOWN_LEVEL_SD_OF_TYPE = 8.0
"""The same without reference throws: machines of a type differ by more than one does from day to day."""
UNKNOWN_WIDTH_RATIO = 0.15
"""Width of the logistic in the log of the excess."""
CONFLICT_SD = 5.0
"""Standard deviations above the expected square of a healthy machine's deviations that may remain."""
SURE_PROBABILITY = 0.8
"""Probability from which a cause is claimed alone."""
OPEN_PROBABILITY = 0.15
"""Probability from which an answer is not ruled out: another cause, or "none", beside which no effect is
claimed."""
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
CLEAR_RATIO = 1.6
"""An impact gap of more than this multiple of a healthy machine's is a measure of an effect."""
