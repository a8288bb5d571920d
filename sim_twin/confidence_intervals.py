"""Confidence intervals of a mean, a standard deviation and a proportion: Student, chi-square, Wilson.

Quantiles come from scipy.special: loading scipy.stats takes seconds in each process that throws.
"""

import math

import numpy as np
from scipy.special import chdtri, stdtrit

from machine.conventions import Array

Interval = tuple[float, float]


def mean_interval(values: Array, confidence_ratio: float) -> Interval:
    """Of the mean of independent normal values (n,), by Student's distribution.

    Raises:
        ValueError: fewer than two values.
    """
    n = int(values.size)
    if n < 2:
        raise ValueError(f"a mean with an interval needs two values, there are {n}")
    sd = float(np.std(values, ddof=1))
    half = float(stdtrit(n - 1, 0.5 + 0.5 * confidence_ratio)) * sd / math.sqrt(n)
    mean = float(np.mean(values))
    return mean - half, mean + half


def deviation_interval(sd: float, count: int, confidence_ratio: float) -> Interval:
    """Of the standard deviation (n - 1) of `count` normal values, by the chi-square of its square.

    Raises:
        ValueError: fewer than two values.
    """
    if count < 2:
        raise ValueError(f"a standard deviation needs two values, there are {count}")
    tail = 0.5 * confidence_ratio
    high, low = chdtri(count - 1, [0.5 - tail, 0.5 + tail])
    return sd * math.sqrt((count - 1) / high), sd * math.sqrt((count - 1) / low)


def proportion_interval(hits: int, count: int, confidence_ratio: float) -> Interval:
    """Of a proportion of `hits` in `count` trials, by Wilson's score; valid at 0 hits and at `count` hits.

    Raises:
        ValueError: no trials, or more hits than trials.
    """
    if count < 1 or not 0 <= hits <= count:
        raise ValueError(f"{hits} hits in {count} trials")
    from scipy.stats import binomtest

    found = binomtest(hits, count).proportion_ci(confidence_ratio, method="wilson")
    return float(found.low), float(found.high)
