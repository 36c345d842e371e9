"""Similar drapes: specimens of any size are one family.

A drape in units of the specimen's size L depends on alpha/(rho g L³), beta/(alpha L), the plate's
diameter over L, the in-plane stiffness over rho g L, the natural curvature times L and the
hysteresis at equal curvature times L.
"""

from dataclasses import replace

from sim.cloth import Laws
from sim.energies.plate_variants import Hysteresis
from sim.material import Fabric
from sim.rig import Rig


def similar(fabric: Fabric, rig: Rig, laws: Laws, factor: float) -> tuple[Fabric, Rig, Laws]:
    """Fabric, rig and laws of the drape that is ``factor`` times as large at equal density.

    The bending law must be :class:`sim.energies.plate_variants.Hysteresis` or the default.
    """
    bending = laws.bending
    if isinstance(bending, Hysteresis):
        curvature = tuple(value / factor for value in bending.curvature)
        origin = None if bending.origin is None else bending.origin / factor
        bending = replace(bending, curvature=curvature, origin=origin, at=bending.at / factor)
    larger = replace(rig, specimen_size=factor * rig.specimen_size,
                     plate_diameter=factor * rig.plate_diameter)
    return (Fabric(factor**3 * fabric.alpha, factor**4 * fabric.beta, fabric.density), larger,
            replace(laws, bending=bending, membrane=laws.membrane.scaled(factor)))
