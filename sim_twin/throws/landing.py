"""Where a previewed load ought to land among the things around the machine, and what it meets instead."""

from collections.abc import Sequence
from typing import NamedTuple

from machine.messages import RejectReason, Target
from machine.site.objects import UNDESCRIBED, SiteObject
from machine.site.solids import Contact, Solids
from sim_twin.throws.refusals import Refusal

BESIDE_M = 2.0
"""Ground that nobody described is not believed in so near to something that somebody did. By eye: the half
of a truck's bed, by which a click or an arrow key may miss it."""


class Landing(NamedTuple):
    """The site as one throw finds it."""

    solids: Solids
    wanted: str
    """Name of what the target lies on."""

    @classmethod
    def of(cls, site: Sequence[SiteObject], target: Target) -> "Landing":
        """The site around a throw at this target."""
        solids = Solids.around(site, target)
        return cls(solids, solids.name_at(target) or solids.names[0])

    def target_refusal(self, target: Target) -> Refusal | None:
        """Why nothing can lie at this target: it hangs in the air, or under the ground, beside an object."""
        near = [(o.distance_m(target.x_m, target.y_m), o) for o in self.solids.objects]
        if self.solids.name_at(target) not in (None, UNDESCRIBED) or not near:
            return None
        away_m, item = min(near, key=lambda pair: pair[0])
        if away_m > BESIDE_M:
            return None
        surface_m = item.surface_m(target.x_m, target.y_m)
        where = f"{away_m:.2f} m beside {item.name}" if surface_m is None else f"at {item.name}"
        there = f", whose surface there is at {surface_m:+.2f} m" if surface_m is not None else ""
        return Refusal(
            RejectReason.TARGET_INVALID,
            f"Refused: nothing is {target.z_m:+.2f} m high there, {where}{there}. Click on the surface "
            "that is meant, or give its height.",
        )

    def met(self, contact: Contact | None, row: int = 0) -> str | None:
        """Name of what the load of a row touches first; None where it touches nothing."""
        if contact is None or contact.solid[row] < 0:
            return None
        return self.solids.names[int(contact.solid[row])]

    def refusals(self, contact: Contact | None) -> tuple[Refusal, ...]:
        """What speaks against the nominal throw."""
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
        return (Refusal(RejectReason.PREVIEW_REFUSED, f"Refused: {text}"),)

    def bad_ends(self, contact: Contact | None) -> list[str]:
        """How scattered throws end that meet something else than they should, one entry each."""
        if contact is None:
            return []
        ends: list[str] = []
        for row, is_side in enumerate(contact.is_side.tolist()):
            met = self.met(contact, row)
            if met is None:
                continue  # counted as a throw that does not come down
            if is_side:
                ends.append(f"hit the side of {met}")
            elif met != self.wanted:
                ends.append(f"on {met} instead of {self.wanted}")
        return ends
