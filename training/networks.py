"""Actor and critic: multilayer perceptrons with ELU, and the running normaliser of their inputs."""

from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

Field = Any
Layers = tuple[tuple[Field, Field], ...]
"""Weights (in, out) and biases (out,) of each layer."""

NORMALISED_LIMIT = 10.0
"""Bound of normalised inputs: a sensor fault must not drive the network out of its range."""


class Normaliser(NamedTuple):
    """Running mean and variance of each input."""

    mean: Field
    variance: Field
    count: Field


class Networks(NamedTuple):
    """Parameters learned by gradient."""

    actor: Layers
    critic: Layers
    log_deviation: Field
    """(A,) log standard deviation of the actions, independent of the state."""


def make_layers(key: Field, sizes: tuple[int, ...], last_scale: float) -> Layers:
    """Orthogonal weights (gain sqrt 2, the last layer `last_scale`), zero biases."""
    keys = jax.random.split(key, len(sizes) - 1)
    layers: list[tuple[Field, Field]] = []
    for index, (fan_in, fan_out) in enumerate(pairwise(sizes)):
        scale = last_scale if index == len(sizes) - 2 else 2.0**0.5
        weights = jax.nn.initializers.orthogonal(scale)(keys[index], (fan_in, fan_out), jnp.float32)
        layers.append((weights, jnp.zeros(fan_out)))
    return tuple(layers)


def apply_layers(layers: Layers, x: Field, hidden_type: Any = jnp.float32) -> Field:
    """Run a perceptron on (..., in); ELU between layers, linear at the end.

    `hidden_type` is what the hidden layers' outputs are kept in: bfloat16 halves what a GPU moves. Inputs,
    sums and the last layer stay float32.
    """
    last = len(layers) - 1
    for index, (weights, bias) in enumerate(layers):
        if 0 < index < last:
            weights = weights.astype(hidden_type)
        elif index == last:
            x = x.astype(jnp.float32)
        x = jnp.matmul(x, weights, preferred_element_type=jnp.float32) + bias
        if index < last:
            x = jax.nn.elu(x).astype(hidden_type)
    return x


def make_networks(
    key: Field,
    observation_count: int,
    hidden_input_count: int,
    action_count: int,
    hidden: tuple[int, ...],
    log_deviation: float,
) -> Networks:
    """Initial networks; the critic's input is observation and privileged values."""
    keys = jax.random.split(key, 2)
    return Networks(
        actor=make_layers(keys[0], (observation_count, *hidden, action_count), 0.01),
        critic=make_layers(keys[1], (observation_count + hidden_input_count, *hidden, 1), 1.0),
        log_deviation=jnp.full(action_count, log_deviation),
    )


def make_normaliser(count: int) -> Normaliser:
    """Initial normaliser."""
    return Normaliser(jnp.zeros(count), jnp.ones(count), jnp.asarray(1e-4))


def update_normaliser(normaliser: Normaliser, batch: Field) -> Normaliser:
    """Merge the moments of a batch (..., D) (Chan et al. 1983)."""
    flat = batch.reshape(-1, batch.shape[-1])
    count = float(flat.shape[0])
    mean, variance = flat.mean(0), flat.var(0)
    total = normaliser.count + count
    delta = mean - normaliser.mean
    merged = (
        normaliser.variance * normaliser.count
        + variance * count
        + jnp.square(delta) * normaliser.count * count / total
    )
    # Capped, so that the moments follow the changing policy.
    return Normaliser(
        normaliser.mean + delta * count / total, merged / total, jnp.minimum(total, 2e8)
    )


def normalise(normaliser: Normaliser, values: Field) -> Field:
    """Shift and scale (..., D) to zero mean and unit variance, clipped."""
    scaled = (values - normaliser.mean) / jnp.sqrt(normaliser.variance + 1e-6)
    return jnp.clip(scaled, -NORMALISED_LIMIT, NORMALISED_LIMIT)
