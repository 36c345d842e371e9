"""Scenes in which the hem of a drape is hard to see, or something else looks like cloth."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import trimesh

from common.types import Metres, Points
from data.render import textures
from data.render.scenery import Scenery, Thing

Change = Callable[[Scenery, Metres, np.random.Generator], Scenery]
"""Of a scene, whose flat specimen has a reach."""


def _ground(scenery: Scenery, rng: np.random.Generator) -> np.ndarray:
    """Albedo (3,) as light as that of the ground, nearly."""
    if scenery.mat is None:
        light = scenery.table(rng.uniform(-0.1, 0.1, (1, 2)))[0]
    else:
        light = scenery.mat_light[1] * scenery.mat_ground * (
            1.0 if scenery.gain is None else rng.uniform(0.1, 1.0))
    return np.clip(light * np.exp(rng.normal(0, 0.12) + rng.normal(0, 0.03, 3)), 0.015, 0.93)


def alike(scenery: Scenery, _: Metres, rng: np.random.Generator) -> Scenery:
    """Cloth as light as its ground."""
    return replace(scenery, surface=textures.plain(_ground(scenery, rng), rng,
                                                   rng.choice([0.02, 0.1])))


def bordered(scenery: Scenery, _: Metres, rng: np.random.Generator) -> Scenery:
    """A border of 5 to 30 mm, mostly as light as the ground."""
    edge = _ground(scenery, rng) if rng.random() < 0.7 else textures.colour(rng)
    return replace(scenery, surface=textures.bordered(
        scenery.surface, scenery.rest, rng.uniform(5e-3, 0.03), edge))


def striped(scenery: Scenery, _: Metres, rng: np.random.Generator) -> Scenery:
    """Stripes or checks of which a part is as light as the ground."""
    light, other = _ground(scenery, rng), textures.colour(rng)
    period, share = rng.uniform(0.012, 0.08), rng.uniform(0.3, 0.7)
    turn, checked = rng.uniform(0, np.pi), rng.random() < 0.3

    def texture(places: np.ndarray) -> np.ndarray:
        along = places @ np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        pale = along % period < share * period
        return np.where((pale.any(axis=1) if checked else pale[:, 0])[:, None], light, other)

    return replace(scenery, surface=texture)


def footed(scenery: Scenery, reach: Metres, rng: np.random.Generator) -> Scenery:
    """A wide foot on the ground, seen between the folds, often of the cloth's colour."""
    wide, high = rng.uniform(0.7, 1.05) * reach, rng.uniform(2e-3, 0.025)
    low = float(scenery.cloth[:, 2].min())
    if rng.random() < 0.5:
        mesh = trimesh.creation.cylinder(wide, min(high, max(low, 1e-3)), sections=64)
    else:
        mesh = trimesh.creation.box([1.5 * wide, 1.5 * wide, min(high, max(low, 1e-3))])
    tone = rng.random()
    light = (scenery.surface(np.zeros((1, 2)))[0] if tone < 0.4 else
             np.full(3, rng.uniform(0.02, 0.06)) if tone < 0.7 else textures.colour(rng))
    return _with(scenery, mesh, np.zeros(2), textures.plain(light, rng, 0.03), rng)


def littered(scenery: Scenery, reach: Metres, rng: np.random.Generator) -> Scenery:
    """An offcut of the same cloth on the ground beside the hem."""
    around, size = rng.uniform(0, 2 * np.pi), np.exp(rng.uniform(np.log(0.03), np.log(0.12), 2))
    far = rng.uniform(0.85, 1.05) * reach + size.min() / 2
    mesh = trimesh.creation.box([*size, 6e-4])
    return _with(scenery, mesh, far * np.array([np.cos(around), np.sin(around)]),
                 scenery.surface, rng)


def laced(scenery: Scenery, reach: Metres, rng: np.random.Generator) -> Scenery:
    """A border of 8 to 25 mm with holes."""
    wide, period = rng.uniform(8e-3, 0.025), rng.uniform(2.5e-3, 6e-3)
    inside, share = textures.inside(scenery.rest), rng.uniform(0.25, 0.38)

    def holes(places: np.ndarray) -> np.ndarray:
        cell = np.hypot(*((places / period % 1 - 0.5).T))
        return (inside(places) < wide) & (inside(places) > 8e-4) & (cell < share)

    return replace(scenery, holes=holes)


def _with(scenery: Scenery, mesh: trimesh.Trimesh, place: np.ndarray, texture: textures.Texture,
          rng: np.random.Generator) -> Scenery:
    """A thing that stands on the ground at a place (2,), turned at random."""
    turn = trimesh.transformations.rotation_matrix(rng.uniform(0, np.pi), [0, 0, 1])[:3, :3]
    points: Points = mesh.vertices @ turn.T
    points += np.append(place, -points[:, 2].min())
    return replace(scenery, things=[*scenery.things, Thing(points, mesh.faces, texture)])


HARD: dict[str, Change] = {"alike": alike, "bordered": bordered, "striped": striped,
                           "footed": footed, "littered": littered, "laced": laced}
