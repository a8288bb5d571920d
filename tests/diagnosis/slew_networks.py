"""The slew of a real 40 t material handler: two networks that others trained on its data, as a plant.

Data and order of the inputs: tests/diagnosis/data/liebherr_slew/README.md. Histories run from the newest
sample back, 10 samples 0.1 s apart; the newest pressures and speeds that the first network sees are 0.1 s
old.
"""

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FOLDER = Path(__file__).parent / "data" / "liebherr_slew"
MEAN = np.array([0.0, 77.8, 77.8, 0.0, 4.032e5])
SD = np.array([410.26, 97.74, 97.74, 0.3452, 1.5074e5])
STEP_S = 0.02
HISTORY, STRIDE = 10, 5


class Network:
    """A ReLU perceptron, input (41,)."""

    def __init__(self, name: str) -> None:
        with np.load(FOLDER / name) as stored:
            numbers = sorted({int(key.split(".")[1]) for key in stored})
            self.layers = [
                (stored[f"layers.{n}.weight"], stored[f"layers.{n}.bias"]) for n in numbers
            ]

    def __call__(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        for weight, bias in self.layers[:-1]:
            x = np.maximum(weight @ x + bias, 0.0)
        weight, bias = self.layers[-1]
        return weight @ x + bias


def slew_speed(
    joystick: NDArray[np.float64], inertia_kg_m2: float = 4.032e5
) -> NDArray[np.float64]:
    """Slew speed (ticks,) rad/s of a joystick (ticks,) within +-850, 50 Hz, from rest."""
    pressure_of, speed_of = Network("pressure_net.npz"), Network("velocity_net.npz")
    before = HISTORY * STRIDE + STRIDE
    u = np.concatenate([np.zeros(before), np.clip(joystick, -850.0, 850.0)])
    left, right, speed = np.zeros_like(u), np.zeros_like(u), np.zeros_like(u)
    newest = -np.arange(0, HISTORY * STRIDE, STRIDE)
    older = newest - STRIDE
    inertia = [(inertia_kg_m2 - MEAN[4]) / SD[4]]

    def scaled(index: int, values: NDArray[np.float64]) -> NDArray[np.float64]:
        return (values - MEAN[index]) / SD[index]

    for k in range(before, len(u)):
        command, rate = scaled(0, u[k + newest]), scaled(3, speed[k + older])
        past = [scaled(1, left[k + older]), scaled(2, right[k + older])]
        out = pressure_of(np.concatenate([command, *past, rate, inertia]))
        left[k], right[k] = out * SD[1:3] + MEAN[1:3]
        now = [scaled(1, left[k + newest]), scaled(2, right[k + newest])]
        speed[k] = speed_of(np.concatenate([command, *now, rate, inertia]))[0] * SD[3] + MEAN[3]
    return speed[before:]


def staircase(
    levels: tuple[float, ...], hold_s: float = 6.0, rest_s: float = 4.0
) -> NDArray[np.float64]:
    """Joystick steps to each level with rests between, (ticks,)."""
    hold, rest = round(hold_s / STEP_S), round(rest_s / STEP_S)
    pieces = [np.zeros(rest)]
    for level in levels:
        pieces += [np.full(hold, level), np.zeros(rest)]
    return np.concatenate(pieces)


def write_csv(path: Path, joystick: NDArray[np.float64], speed: NDArray[np.float64]) -> None:
    """A table with time_s, joystick, slew_rad_per_s and slew_rad."""
    time_s = np.arange(len(speed)) * STEP_S
    position = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1])) * STEP_S])
    np.savetxt(
        path,
        np.stack([time_s, joystick, speed, position], axis=1),
        delimiter=",",
        header="time_s,joystick,slew_rad_per_s,slew_rad",
        comments="",
        fmt="%.6g",
    )


LEVELS = (850, -850, 500, -500, 300, -300, 200, -200, 700, -700, 150, -150, 400, -400, 600, -600)

if __name__ == "__main__":
    steps = staircase(tuple(float(level) for level in LEVELS), 5.0, 3.0)
    write_csv(Path(sys.argv[1]), steps, slew_speed(steps))
