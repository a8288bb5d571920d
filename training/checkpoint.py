"""Checkpoints: the whole learner in one file, replaced atomically.

A resumed run gives exactly the results of an uninterrupted one on the same device.
"""

import os
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from zipfile import BadZipFile

import jax
import jax.numpy as jnp
import numpy as np

from machine.errors import UsageError
from training.ppo import Learner

CHECKPOINT_FILE = "checkpoint.npz"


def save_checkpoint(path: Path, learner: Learner, fingerprint: str) -> None:
    """Write the learner and the configuration's fingerprint, replacing the file atomically."""
    arrays = {name: _to_numpy(leaf) for name, leaf in _named(learner)}
    partial = path.with_suffix(".partial.npz")
    with partial.open("wb") as stream:
        np.savez(stream, allow_pickle=False, fingerprint=np.asarray(fingerprint), **arrays)
        stream.flush()
        os.fsync(stream.fileno())
    os.replace(partial, path)


def load_checkpoint(path: Path, like: Learner, fingerprint: str) -> Learner:
    """Read a learner of the same structure as `like`.

    Raises:
        UsageError: the file belongs to another configuration, or is damaged.
    """
    with _opened(path) as stored:
        if str(stored["fingerprint"]) != fingerprint:
            raise UsageError(
                f"{path} was written under another configuration; train into another --out folder, "
                "or give the options of the interrupted run"
            )
        leaves = [_from_numpy(stored[name], leaf) for name, leaf in _named(like)]
    return jax.tree.unflatten(jax.tree.structure(like), leaves)


def load_weights(path: Path, like: Learner) -> Learner:
    """`like` with the networks and the normaliser of another run's checkpoint: a warm start.

    The standard deviation of the actions stays that of `like`, so that the new run explores again.

    Raises:
        UsageError: the other run had networks of other sizes, or the file is no checkpoint.
    """
    wanted = (".networks.actor", ".networks.critic", ".normaliser")
    with _opened(path) as stored:
        leaves: list[jax.Array] = []
        for name, leaf in _named(like):
            if name.startswith(wanted) and stored[name].shape != leaf.shape:
                raise UsageError(
                    f"{path}: {name} has shape {stored[name].shape}, this run needs {leaf.shape}; "
                    "start from a run of the same mode and network"
                )
            leaves.append(_from_numpy(stored[name], leaf) if name.startswith(wanted) else leaf)
    return jax.tree.unflatten(jax.tree.structure(like), leaves)


@contextmanager
def _opened(path: Path) -> Generator[Mapping[str, np.ndarray]]:
    """The arrays of a checkpoint file.

    Raises:
        UsageError: the file is missing, damaged or something else.
    """
    try:
        # Opened here, since NumPy does not close the file of a damaged archive.
        with path.open("rb") as file, np.load(file) as stored:
            yield stored
    except (OSError, EOFError, ValueError, KeyError, BadZipFile) as error:
        raise UsageError(
            f"{path} is not a readable checkpoint ({error}); give another, or train into an empty folder"
        ) from error


def _named(learner: Learner) -> list[tuple[str, jax.Array]]:
    """Leaves with their paths, such as ``.networks.actor[0][0]``."""
    return [
        (jax.tree_util.keystr(path), leaf)
        for path, leaf in jax.tree_util.tree_flatten_with_path(learner)[0]
    ]


def _to_numpy(leaf: jax.Array) -> np.ndarray:
    if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        leaf = jax.random.key_data(leaf)
    return np.asarray(leaf)


def _from_numpy(stored: np.ndarray, template: jax.Array) -> jax.Array:
    if jnp.issubdtype(template.dtype, jax.dtypes.prng_key):
        return jax.random.wrap_key_data(jnp.asarray(stored), impl=jax.random.key_impl(template))
    return jnp.asarray(stored)
