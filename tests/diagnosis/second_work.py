"""Work for two processes; a module of its own, which the second one can import."""

import os


def times(value: int, items: list[int], more: int) -> list[tuple[int, int]]:
    """Work that tells who did it."""
    return [(value * item + more, os.getpid()) for item in items]


def broken(value: int, items: list[int]) -> list[int]:
    """Work that fails on odd items."""
    if any(item % 2 for item in items):
        raise ValueError(f"{value}: odd items")
    return items
