"""Which specimen would say more of a fabric than the one that was draped."""

from sim.rig import Rig

FLAT, LIMP = 0.80, 0.15
"""Drape coefficients above and below which a drape says little of the stiffness (``make evaluate``,
by drape coefficient)."""
_LARGEST, _SMALLEST = 0.36, 0.24  # m, of the discs of Cusick's tester


def advice_of(rig: Rig, coefficient: float) -> list[str]:
    """A sentence if the drape coefficient, from 0 to 1, or NaN, of a capture is one at which this
    specimen says little, else nothing."""
    disc = rig.specimen == "disc"
    if coefficient > FLAT:
        better = "photograph cantilever strips"
        if not disc or rig.specimen_size < _LARGEST:
            better = f"drape a disc of 360 mm on the support of 180 mm, or {better}"
        return [f"with a drape coefficient of {coefficient:.0%} this specimen says little of so "
                f"stiff a fabric: {better}"]
    if coefficient < LIMP and not (disc and rig.specimen_size <= _SMALLEST):
        return [f"with a drape coefficient of {coefficient:.0%} this specimen says little of so "
                "limp a fabric: drape a disc of 240 mm on the support of 180 mm"]
    return []
