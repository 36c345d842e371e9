"""Pages of the Python interface from its docstrings: ``python tools/reference.py FOLDER``."""

import sys
import warnings
from pathlib import Path

import pdoc

import drapenet
import sim

MODULES = ("drapenet", "drapenet.result.estimate", "drapenet.fabric", "drapenet.evidence", "sim",
           "sim.energies", "sim.equilibrium", "sim.material", "sim.measures", "sim.rig",
           "sim.sensitivity", "sim.sensitivity.adjoint", "sim.cantilever", "sim.cantilever.strip",
           "data.captures", "data.readings",
           "!data.readings.known", "data.fabrics", "drapenet.measured",
           "!data.fabrics.prior.__main__")


def main(folder: str, *, show_source: bool = True) -> None:
    """Write the pages; a name that cannot be resolved is an error."""
    for package in (drapenet, sim):
        for name in package.__all__:  # imported when asked for, which pdoc does not do
            setattr(package, name, getattr(package, name))
    pdoc.render.configure(docformat="restructuredtext", show_source=show_source)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        pdoc.pdoc(*MODULES, output_directory=Path(folder))


if __name__ == "__main__":
    main(*sys.argv[1:])
