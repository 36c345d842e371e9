"""Posterior samples of a fabric from a set of its captures by the network.

Turned by a symmetry of its fabric, or reflected, a drape is an equally likely drape of the same
fabric. The posterior is the mixture of the network's posteriors for all such captures.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from common.errors import InputError
from common.findings import Finding
from common.types import Metres
from data.fabrics.fabrics import ClothProperties, from_theta
from drapenet.network.calibration import seen_of
from drapenet.network.checkpoint import Header
from drapenet.network.expected import Likeness
from drapenet.network.inputs import Batch, Facts, Stated
from drapenet.network.posterior import Samples
from drapenet.network.targets import SYMMETRIES, Symmetry, cloth_of, exchanged
from drapenet.network.trained import OfGraphs, Trained, graph_of
from drapenet.views.directions import AZIMUTHS, ELEVATIONS
from drapenet.views.observation import Observation
from drapenet.views.pictures import SIDE
from drapenet.views.radial_map import compressed
from sim.material import is_admissible

DRAWS = 4000  # of each posterior, in all


@lru_cache(maxsize=2)
def network_of(header: Header) -> Trained:
    """The network of a checkpoint; InputError if it does not fit its description, or needs PyTorch
    where that is not installed."""
    if graph_of(header.path).exists():
        return OfGraphs(header)
    try:
        from drapenet.network.weights import Loaded, load_model
    except ModuleNotFoundError as error:
        raise InputError(f"{graph_of(header.path).name} is not beside it, and {error.name} is not "
                         "installed; copy the file that train.py has written, or install "
                         "drapenet[train]", source=header.path) from None
    return Loaded(load_model(header))


@dataclass(frozen=True)
class Draws:
    """Samples of one posterior: warp, bias and weft, or, if the warp's direction is not known, the
    stiffer yarns first."""

    cloth: ClothProperties
    known: bool
    impossible: float  # share of all samples that was not admissible and is removed
    likeness: tuple[Likeness, ...] = ()  # of each capture, if compared by a network that can
    told: bool = False  # whether the network has read the membrane stiffness as stated

    def unlike(self, size: Metres, causes: str) -> list[Finding]:
        """A finding for each capture, of specimens of a ``size``, that is unlike drapes of these
        samples; ``causes``: what to check then, the likeliest first."""
        return [found for one in self.likeness if (found := one.warning(size, causes))]

    @classmethod
    def possible(
        cls, cloth: ClothProperties, known: bool, likeness: Sequence[Likeness] = ()
    ) -> "Draws":
        """The admissible samples; all if none is."""
        possible = is_admissible(*from_theta(cloth.theta))
        kept = possible if possible.any() else ~possible
        return cls(cloth.chosen(kept), known, float(1 - possible.mean()), tuple(likeness))


def sample_targets(network: Trained, header: Header, batch: Batch, known: np.ndarray) -> Samples:
    """:data:`DRAWS` samples of the targets of each set, not standardised, whose deviations
    are calibrated; ``known``: (N,) of the captures, as in
    :class:`drapenet.network.inputs.Facts`."""
    drawn = []
    along = np.zeros(int(batch.group.max()) + 1, bool)  # known, of each set
    along[batch.group] = known
    for k in range(SYMMETRIES):
        posterior = network.posterior(batch.turned(Symmetry.number(k, len(known))))
        samples = posterior.sample(DRAWS // SYMMETRIES, np.random.default_rng(k))
        drawn.append(exchanged(header.scale.decode(samples), along & (k % 2 > 0)))
    samples = np.concatenate(drawn)
    calibration = header.calibration
    return calibration.applied(samples, seen_of(batch, samples)) if calibration else samples


def predict(
    network: Trained, header: Header, sets: Sequence[Sequence[Observation]],
    stated: Sequence[Stated] = (), *, compared: bool = False,
) -> list[Draws]:
    """Posterior samples of each of the ``sets`` of captures of one fabric each, of which something
    may be ``stated``, ``compared`` with the captures, which takes 0.05 s for each; InputError if
    the network has not learned to read one of them."""
    for capture in (capture for captures in sets for capture in captures):
        header.require_input("depth" if capture.map else "outline" if capture.outline else
                             "numbers")
    batch, facts = batch_of(sets, stated)
    samples = sample_targets(network, header, batch, facts.known)
    told = np.isfinite(facts.membrane)
    known = [all(part.known for part in captures) for captures in sets]
    likeness = network.likeness(batch, header.scale.encode(samples)) if compared else []
    return [replace(Draws.possible(cloth_of(samples[:, k], np.full(len(samples), size)), known[k],
                                   [one for n, one in enumerate(likeness) if facts.group[n] == k]),
                    told=bool(told[facts.group == k].all()))
            for k, size in enumerate(facts.sizes)]


def batch_of(
    sets: Sequence[Sequence[Observation]], stated: Sequence[Stated] = ()
) -> tuple[Batch, Facts]:
    """The network's input of ``sets`` of captures, and what is ``stated`` of each, if anything."""
    stated = stated or [Stated()] * len(sets)
    captures = [capture for group in sets for capture in group]
    group = np.repeat(np.arange(len(sets)), [len(part) for part in sets])
    empty = np.zeros((AZIMUTHS, ELEVATIONS))
    maps = [(part.map.distance / part.rig.specimen_size, part.map.weight) if part.map else
            (empty, empty) for part in captures]
    nothing = np.full(AZIMUTHS, np.nan)
    outlines = [part.outline.radius / (part.rig.specimen_size / 2) if part.outline else nothing
                for part in captures]
    exact = np.zeros(AZIMUTHS)
    errors = [exact if part.outline is None or part.outline.error is None else
              part.outline.error / (part.rig.specimen_size / 2) for part in captures]
    known = np.array([all(part.known for part in sets[k]) for k in group.tolist()])
    sizes = np.array([part.rig.specimen_size for part in captures])
    heights = np.array([part.outline.height if part.outline else np.nan for part in captures])
    facts = Facts(
        size=sizes, plate=np.array([part.rig.plate_diameter for part in captures]) / sizes,
        disc=np.array([part.rig.specimen == "disc" for part in captures]),
        aspect=np.array([part.rig.aspect for part in captures]),
        face=np.array([part.face for part in captures]), known=known,
        views=np.array([part.map.views if part.map else 0 for part in captures]),
        perspective=sizes / heights,
        coefficient=np.array([part.outline.coefficient(part.rig) if part.outline else
                              part.coefficient for part in captures]),
        nodes=np.array([part.nodes for part in captures]),
        rim=np.array([part.rig.rim or np.nan for part in captures]),  # 0: not stated
        membrane=np.array([one.membrane for one in stated])[group],
        kind=np.array([one.kind for one in stated])[group], group=group)
    distance, weight = compressed(*(np.array(part) for part in zip(*maps, strict=True)))
    depth = np.zeros((len(captures), 0, SIDE, SIDE), np.float16)
    angle = np.zeros(len(captures))
    if all(part.pictures for part in captures):  # what does not read them need not have them
        pictures = [part.pictures for part in captures if part.pictures]
        depth = np.array([picture.depth for picture in pictures])
        angle = np.array([picture.angle for picture in pictures])
    return Batch.of(distance, weight, np.array(outlines), np.array(errors), facts, depth,
                    angle), facts
