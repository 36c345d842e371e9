"""Files of simulators: ARCSim, ppf-contact-solver and Newton."""

import json

import numpy as np

from drapenet.export.material import Material, as_json, left_to_tool, script
from sim.energies.hinges import ARCSIM
from sim.energies.membrane import OrthotropicStVK
from sim.material import BIAS, WARP, WEFT, torque
from sim.tension import POISSON

PPF = 1.28e-5  # m²/s²: BEND_SCALE of ppf-contact-solver's energy.cu
STYLE3D = 3.0  # Newton's quadratic hinges: plate of modulus 3 ke
ARCSIM_CURVATURES = np.array([0.0, 10.0, 20.0, 30.0, 40.0])
"""1/m, of ARCSim's table: theta l/(A0 + A1) is twice the number that its columns count in steps of
5/m (``dde.cpp``, ``bending_stiffness``); it is constant beyond the last column."""
ARCSIM_STRETCHING = 6
"""Samples of ARCSim's table of stretching: without strain, and of five directions with it."""


def arcsim(material: Material, name: str) -> dict[str, bytes]:
    """A material file."""
    alpha, beta = (part * material.ratio for part in (material.alpha, material.beta))
    kappa = np.maximum(ARCSIM_CURVATURES, 1e-9)
    secants = torque(kappa, alpha[:, None], beta[:, None]) / kappa
    rows = secants / ARCSIM  # over the curvature: 4 alpha + 4 beta kappa
    # Rows are indexed by the edge's direction in material axes; cloth bends across the edge.
    content = {"density": material.density, "bending": rows[[WEFT, BIAS, WARP]].tolist()}
    if (stretching := _arcsim_stretching(material)):
        content["stretching"] = [stretching] * ARCSIM_STRETCHING
    return {name: as_json(content | {"drapenet": material.about_hinges | left_to_tool(
        ["stretching", "damping", "friction", "repulsion_thickness"], content)})}


def _arcsim_stretching(material: Material) -> list[float] | None:
    """The sample of all strains, N/m: ARCSim doubles it to k, and its stress is k0 E_uu + k1 E_vv,
    k1 E_uu + k2 E_vv and k3 E_uv in the Green strain (``dde.cpp``, ``physics.cpp``)."""
    if not (material.stretch and material.shear):
        return None
    warp, weft = material.stretch
    law = OrthotropicStVK(warp=warp, weft=weft, poisson=POISSON * (warp / weft) ** 0.5,
                          shear=material.shear).matrix
    return [law[0, 0] / 2, law[0, 1] / 2, law[1, 1] / 2, law[2, 2]]


def ppf(material: Material, name: str) -> dict[str, bytes]:
    """Parameters of a shell."""
    warp, _, weft = (material.modulus * material.ratio / (PPF * material.density)).tolist()
    base, known = min(warp, weft), material.known
    values: dict[str, float | str] = {
        "bend": base, "bend-warp": warp - base, "bend-weft": weft - base,
        "density": material.density}
    if material.stretch and material.shear:
        # Baraff and Witkin's energy for each kg: mu/2 of the yarns' extensions squared, lambda/2 of
        # the sine of the shear angle squared (``baraffwitkin.hpp``).
        mu, shear = sum(material.stretch) / 2 / material.density, material.shear / material.density
        poisson = shear / (2 * (mu + shear))
        values |= {"model": "baraff-witkin", "young-mod": 2 * (1 + poisson) * mu,
                   "poiss-rat": poisson}
    if "friction" in known:
        values["friction"] = known["friction"]
    if "thickness_mm" in known:  # the offsets of two layers are added
        values["contact-offset"] = 1e-3 * known["thickness_mm"] / 2
    about = material.about_hinges | left_to_tool(
        ["model", "young-mod", "poiss-rat", "friction", "contact-offset", "contact-gap",
         "strain-limit", "deformation-damping", "bending-damping"], values)
    lines = [f"# {line}" for line in json.dumps(about, indent=1).splitlines()]
    lines += ["# bend-warp and bend-weft are added to bend; one of them is 0",
              *(f"{key} = {json.dumps(value)}" for key, value in values.items())]
    return {name: ("\n".join(lines) + "\n").encode()}


def newton(material: Material, name: str) -> dict[str, bytes]:
    """A module with the values and the assignment of VBD's."""
    modulus, known = material.modulus * material.ratio, material.known
    values = {
        "tri_aniso_ke": [*material.stretch[::-1], material.shear] if (
            material.stretch and material.shear) else None,
        "particle_radius": 1e-3 * known["thickness_mm"] / 2 if "thickness_mm" in known else None,
        "soft_contact_mu": known.get("friction")}
    return {name: script("newton.txt", {
        "density_kg_m2": material.density, "alpha_N_m": modulus.tolist(),
        "edge_aniso_ke": (modulus[[WEFT, WARP, BIAS]] / STYLE3D).tolist(), **values,
        "about": material.about_hinges | left_to_tool(
            [*values, "tri_ke", "tri_ka", "tri_kd", "edge_kd"],
            [key for key, value in values.items() if value is not None])})}
