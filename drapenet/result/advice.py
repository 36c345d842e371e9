"""Which specimen would say more of a fabric than the one that was draped."""

from collections.abc import Iterable

from common.findings import Finding
from sim.rig import Rig

FLAT, LIMP = 0.80, 0.15
"""Drape coefficients above and below which a drape says little of the stiffness (``make evaluate``,
by drape coefficient)."""
_LARGEST, _SMALLEST = 0.36, 0.24  # m, of the discs of Cusick's tester


def advice_of(rig: Rig, coefficient: float) -> list[Finding]:
    """An advice if the drape coefficient, from 0 to 1, or NaN, of a capture is one at which this
    specimen says little, else nothing."""
    disc = rig.specimen == "disc"
    if coefficient > FLAT:
        largest = disc and rig.specimen_size >= _LARGEST
        return [Finding("strips_for_stiff" if largest else "specimen_for_stiff",
                        {"value": float(coefficient)})]
    if coefficient < LIMP and not (disc and rig.specimen_size <= _SMALLEST):
        return [Finding("specimen_for_limp", {"value": float(coefficient)})]
    return []


def joint_advice(captures: Iterable[list[Finding] | None]) -> list[Finding]:
    """The advice of a fabric from that of each of its captures: none as soon as one specimen says
    enough, and strips rather than a disc that was draped already."""
    every = [advice or [] for advice in captures]
    found = {one.code: one for advice in every for one in advice} if all(every) else {}
    if "strips_for_stiff" in found:
        found.pop("specimen_for_stiff", None)
    return [*found.values()]
