"""Landings of a previewed throw on the objects around the machine."""

from collections.abc import Sequence
from typing import NamedTuple

from machine.messages import RejectReason, Target
from machine.site.objects import GROUND, UNDESCRIBED, SiteKind, SiteObject
from machine.site.solids import SURFACE_TOLERANCE_M, Contact, Solids
from sim_twin.throws.refusals import PreviewRefusal

GROUND_M = 0.0
BESIDE_M = 2.0
"""Distance from a described object within which a target must lie on a described surface. A target nearer
than half the width of a truck's bed is more likely meant to lie on the object."""


class SiteLanding(NamedTuple):
    """Objects of the site, and the one that a throw is aimed at."""

    solids: Solids
    wanted: str
    """Name of the surface under the target."""

    @classmethod
    def of(cls, site: Sequence[SiteObject], target: Target) -> "SiteLanding":
        """The site around a throw at a target."""
        solids = Solids.around(site, target)
        return cls(solids, solids.name_at(target) or solids.names[0])

    def target_refusal(self, target: Target) -> PreviewRefusal | None:
        """Refusal of a target near an object that lies on no surface: inside, in the air, below ground."""
        near = [(o.distance_m(target.x_m, target.y_m), o) for o in self.solids.objects]
        name = self.solids.name_at(target)
        is_covered = name == GROUND and any(_covers_ground(o, target) for _, o in near)
        if not near or (name not in (None, UNDESCRIBED) and not is_covered):
            return None
        away_m, item = min(near, key=lambda pair: pair[0])
        if away_m > BESIDE_M:
            return None
        surface_m = item.surface_m(target.x_m, target.y_m)
        if surface_m is None:
            cause = (
                f"nothing is {target.z_m:+.2f} m high {away_m:.2f} m beside {item.name}, "
                f"where the ground is at {GROUND_M:+.2f} m"
            )
            surface_m = GROUND_M
        else:
            side = "lies inside" if target.z_m < surface_m else "hangs above"
            end = "floor" if item.kind is SiteKind.PIT else "top"
            cause = (
                f"the target at {target.z_m:+.2f} m {side} {item.name}, "
                f"whose {end} there is at {surface_m:+.2f} m"
            )
        return PreviewRefusal(
            RejectReason.TARGET_INVALID,
            f"Refused: {cause}. Use that height, or choose another point.",
            surface_m,
        )

    def met(self, contact: Contact | None, row: int = 0) -> str | None:
        """Name of the surface that the load of a row touches first; None without contact."""
        if contact is None or contact.solid[row] < 0:
            return None
        return self.solids.names[int(contact.solid[row])]

    def refusals(self, contact: Contact | None) -> tuple[PreviewRefusal, ...]:
        """Refusals of the nominal throw."""
        met = self.met(contact)
        if contact is None or met is None:
            return ()
        if contact.is_side[0]:
            x_m, y_m, height_m = contact.point_m[0].tolist()
            text = (
                f"the load hits the side of {met} at height {height_m:+.2f} m, "
                f"{(x_m**2 + y_m**2) ** 0.5:.2f} m out. Choose a target with a free way to it, or "
                f"farther from the edge."
            )
        elif met != self.wanted:
            text = f"the load lands on {met}, not on {self.wanted}. Choose another target."
        else:
            return ()
        return (PreviewRefusal(RejectReason.PREVIEW_REFUSED, f"Refused: {text}"),)

    def wrong_contacts(self, contact: Contact | None) -> list[str]:
        """Descriptions of scattered throws that touch another surface than intended, one per throw."""
        if contact is None:
            return []
        ends: list[str] = []
        for row, is_side in enumerate(contact.is_side.tolist()):
            met = self.met(contact, row)
            if met is None:
                continue  # Counted as a throw without an impact.
            if is_side:
                ends.append(f"hit the side of {met}")
            elif met != self.wanted:
                ends.append(f"on {met} instead of {self.wanted}")
        return ends


def _covers_ground(item: SiteObject, target: Target) -> bool:
    """Whether an object stands on the ground under a target."""
    on_it = item.surface_m(target.x_m, target.y_m) is not None
    return on_it and item.kind is not SiteKind.PIT and item.base_height_m <= SURFACE_TOLERANCE_M
