"""Where a previewed load ought to land among the things around the machine, and what it meets instead."""

from collections.abc import Sequence
from typing import NamedTuple

from machine.messages import RejectReason, Target
from machine.site.objects import GROUND, SiteObject
from machine.site.solids import Contact, Solids
from sim_twin.throws.refusals import Refusal


class Landing(NamedTuple):
    """The site as one throw finds it."""

    solids: Solids
    wanted: str
    """Name of what the target lies on."""

    @classmethod
    def of(cls, site: Sequence[SiteObject], target: Target) -> "Landing":
        """The site around a throw at this target."""
        solids = Solids.around(site, target)
        return cls(solids, solids.name_at(target) or GROUND)

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
