"""Colours and camera positions of the 3D view, for light and dark rooms. One accent; red is for faults."""

import math
from dataclasses import dataclass
from typing import Literal

Rgb = tuple[int, int, int]
Vector = tuple[float, float, float]
ThemeName = Literal["light", "dark"]
CameraPreset = Literal["3d", "top", "side"]


@dataclass(frozen=True)
class Theme:
    """sRGB 0..255; `server/viewer_proxy/page.css` repeats `haze` as the page's background."""

    is_dark: bool
    haze: Rgb
    ground: Rgb
    grid_cell: Rgb
    grid_section: Rgb
    dim: Rgb
    dim_ratio: float
    ring: Rgb
    accent: Rgb
    measured: Rgb
    past: Rgb
    lost: Rgb
    light_intensity_ratio: float
    sky_intensity_ratio: float
    shadow_ratio: float
    site: Rgb
    site_edge: Rgb
    pit: Rgb
    zone: Rgb
    material: Rgb


THEMES: dict[ThemeName, Theme] = {
    "light": Theme(
        is_dark=False,
        haze=(226, 231, 236),
        ground=(205, 208, 209),
        grid_cell=(190, 194, 197),
        grid_section=(168, 173, 178),
        dim=(70, 80, 92),
        dim_ratio=0.18,
        ring=(52, 60, 70),
        accent=(24, 100, 190),
        measured=(20, 24, 30),
        past=(110, 118, 128),
        lost=(120, 126, 134),
        light_intensity_ratio=2.2,
        sky_intensity_ratio=0.55,
        shadow_ratio=0.35,
        site=(150, 158, 166),
        site_edge=(72, 80, 90),
        pit=(146, 138, 126),
        zone=(190, 90, 0),
        material=(172, 146, 108),
    ),
    "dark": Theme(
        is_dark=True,
        haze=(26, 29, 33),
        ground=(52, 57, 63),
        grid_cell=(66, 72, 79),
        grid_section=(80, 87, 95),
        dim=(8, 9, 11),
        dim_ratio=0.38,
        ring=(176, 184, 193),
        accent=(92, 174, 255),
        measured=(245, 247, 250),
        past=(140, 148, 158),
        lost=(120, 126, 134),
        light_intensity_ratio=1.7,
        sky_intensity_ratio=0.35,
        shadow_ratio=0.5,
        site=(96, 104, 112),
        site_edge=(168, 176, 186),
        pit=(38, 36, 33),
        zone=(255, 170, 60),
        material=(128, 108, 80),
    ),
}


MIN_ASPECT_RATIO = 0.5


@dataclass(frozen=True)
class Viewpoint:
    """A camera pose, frame `machine`."""

    position_m: Vector
    look_at_m: Vector
    fov_rad: float
    """From top to bottom, of a picture at least `whole_aspect_ratio` times as wide as high."""
    whole_aspect_ratio: float
    """Smallest width over height at which machine and reach rings fit into the picture."""

    def fov_of(self, aspect_ratio: float) -> float:
        """Angle from top to bottom, rad, with which a narrower picture shows as much from left to right.

        Args:
            aspect_ratio: width over height of the picture.
        """
        wider_ratio = max(self.whole_aspect_ratio / max(aspect_ratio, MIN_ASPECT_RATIO), 1.0)
        return 2.0 * math.atan(math.tan(0.5 * self.fov_rad) * wider_ratio)


VIEWPOINTS: dict[CameraPreset, Viewpoint] = {
    # From the right and above: long is to the right. The machine's rear and a target 11 m ahead are in it.
    # Near enough for shadows: viser draws them up to 20 m from the camera.
    "3d": Viewpoint((2.4, -14.0, 9.2), (5.1, -0.9, 0.0), 0.88, 1.2),
    # From far above with a narrow lens: close to a map. A hair of tilt keeps x upward.
    "top": Viewpoint((-0.2, 0.0, 52.0), (0.0, 0.0, 0.0), 0.52, 1.0),
    "side": Viewpoint((3.6, -27.0, 3.4), (3.6, 0.0, 1.9), 0.52, 1.25),
}
MIN_ORBIT_M = 2.0
MAX_ORBIT_M = 90.0
