"""Synthetic photographs of a strip with two pen marks that lies over the printed mat, with and
without a weight; drawn in the plane of the strip, without ray casting."""

from dataclasses import dataclass

import numpy as np

from common.types import Metres, Radians
from data.pictures.mat import GROUNDS, MATS
from data.pictures.planes import behind
from data.pictures.pose import Pose
from data.pictures.reading import decoded
from data.render import textures
from data.render.phone import as_jpeg, random_pose, rays_of
from data.render.scenery import lay_mat
from data.render.textures import Texture

SIZE = (1840, 1380)  # pixels
HEIGHTS = (0.4, 0.65)  # m, of the camera, so that an A3 mat fills the picture
_SOFT = 1.5e-4  # m, over which the border of ink is grey
_PENS = (0.02, 0.9)  # albedo of black ink, and of white chalk
_CONTRAST = 0.5  # least difference of the pen's log albedo from the cloth's


@dataclass(frozen=True)
class Mark:
    """A line across the strip, drawn by hand.

    Attributes:
        place: along the unstretched strip, from its middle.
        slope, waves: of the line, and amplitudes (K,), m, of its cosines across the width.
        thickness: of the pen.
        ink: albedo (3,).
        cover: share of the cloth's colour that it hides.
    """

    place: Metres
    slope: float
    waves: np.ndarray
    thickness: Metres
    ink: np.ndarray
    cover: float

    def at(self, across: np.ndarray) -> np.ndarray:
        """Places (N,) along the strip of the line, by those across it, in widths."""
        turns = np.pi * np.arange(1, len(self.waves) + 1)
        waves = np.cos(turns * (across[:, None] + 0.5)) @ self.waves
        return self.place + self.slope * across + waves


@dataclass(frozen=True)
class MarkedStrip:
    """A strip of cloth over a mat, and the light.

    Attributes:
        width, length: of the unstretched strip.
        slope: of the light (2,), relative change per m along the mat.
        shadow: (2,) m of shadow per m of height, and its depth.
        kind: what results say of it.
    """

    cloth: Texture
    width: Metres
    length: Metres
    marks: tuple[Mark, ...]
    mat: str
    ground: np.ndarray
    table: Texture
    slope: np.ndarray
    shadow: np.ndarray
    depth: float
    kind: dict

    @classmethod
    def random(
        cls, rng: np.random.Generator, *, gauge: Metres, width: Metres, mat: str = "a3",
        ground: str = "white", length: Metres = 0.3
    ) -> "MarkedStrip":
        """A strip of random cloth with two marks a ``gauge`` apart, give or take 1 mm, by one pen:
        one that differs from all colours of the cloth, if there is one."""
        pattern, cloth = textures.cloth(rng)
        shown = np.log(cloth(rng.uniform(-0.5, 0.5, (500, 2)) * [length, width]))
        inks = np.vstack([np.repeat(rng.uniform(*_PENS, (3, 1)), 3, axis=1),
                          rng.uniform(0.03, 0.7, (3, 3))])
        differ = np.abs(np.log(inks)[:, None] - shown).max(axis=2)
        seen = np.quantile(differ, 0.1, axis=1)  # from all colours of the cloth
        ink = inks[seen.argmax() if rng.random() < 0.5 or not (seen > _CONTRAST).any() else
                   rng.choice(np.flatnonzero(seen > _CONTRAST))]
        thickness, cover = rng.uniform(0.5e-3, 1.8e-3), rng.uniform(0.6, 1.0)
        apart, middle = gauge + rng.normal(0, 1e-3), rng.normal(0, 3e-3)
        marks = tuple(
            Mark(middle + side * apart / 2, rng.normal(0, 0.8e-3),
                 rng.normal(0, 2e-4, 3) / np.array([1, 2, 3]),
                 thickness * rng.uniform(0.85, 1.15), ink, cover) for side in (-1, 1))
        around = rng.uniform(0, 2 * np.pi)
        return cls(cloth, width, length, marks, mat, decoded(np.array(GROUNDS[ground]) / 255),
                   textures.table(rng), rng.normal(0, 0.5, 2),
                   rng.uniform(0.2, 1.5) * np.array([np.cos(around), np.sin(around)]),
                   rng.uniform(0.2, 0.7),
                   {"pattern": pattern, "thickness_mm": 1e3 * thickness, "ground": ground,
                    "ink": ink.round(3).tolist()})

    def gauge(self, stretch: float = 1.0) -> Metres:
        """Distance of the marks, mean over the width, of the strip stretched so many times."""
        across = np.linspace(-0.4, 0.4, 81)
        low, high = (mark.at(across).mean() for mark in self.marks)
        return float(stretch * (high - low))

    def pose(self, rng: np.random.Generator, lens: tuple[float, float]) -> Pose:
        """A camera over the mat; ``lens`` as :func:`data.render.phone.random_pose` has it."""
        return random_pose(rng, SIZE, lens, 0.0, 0.12, np.inf, HEIGHTS)

    def photograph(
        self, pose: Pose, rng: np.random.Generator, *, stretch: float = 1.0, narrow: float = 1.0,
        place: tuple[Metres, Metres] = (0.0, 0.0), turn: Radians = 0.0, height: Metres = 0.0
    ) -> bytes:
        """A JPEG file of the strip, ``stretch`` times as long and ``narrow`` times as wide, whose
        middle is at a ``place`` of the mat and which points along ``turn`` from the mat's arrow;
        ``height``: of its plane above the mat."""
        columns, rows = np.meshgrid(*(np.arange(n, dtype=float) for n in pose.size))
        rays = rays_of(pose, np.column_stack([columns.ravel(), rows.ravel()]))
        eye = pose.place
        above = eye[:2] + rays[:, :2] * ((height - eye[2]) / rays[:, 2])[:, None]
        below = behind(above, eye, height)
        cos, sin = np.cos(turn), np.sin(turn)
        size = np.array([stretch * self.length, narrow * self.width])

        def own(places: np.ndarray) -> np.ndarray:
            return (places - place) @ np.array([[cos, -sin], [sin, cos]]) / size

        share = own(above)
        on = (np.abs(share) < 0.5).all(axis=1)
        beside = np.abs(below) > np.array(MATS[self.mat].size) / 2
        bare = ~on & beside.any(axis=1)
        albedo = np.zeros((len(below), 3))
        albedo[bare] = self.table(below[bare])
        lay_mat(albedo, below, self.mat, (0.05, 0.8), self.ground)
        if height > 0:
            cast = np.abs(own(below + height * self.shadow)).max(axis=1) < 0.5
            albedo[cast] *= 1 - self.depth * min(1.0, height / 2e-3)
        albedo[on] = self._surface(share[on])
        light = albedo * np.maximum(1 + below @ self.slope, 0.1)[:, None]
        return as_jpeg(light.reshape(*pose.size[::-1], 3), pose, rng)

    def _surface(self, share: np.ndarray) -> np.ndarray:
        """Albedo (N, 3) of places (N, 2), in lengths and widths of the strip from its middle."""
        along, across = share.T
        albedo = self.cloth(share * [self.length, self.width])
        for mark in self.marks:
            off = np.abs(self.length * along - mark.at(across))
            ink = mark.cover * np.clip((mark.thickness / 2 - off) / _SOFT + 0.5, 0, 1)
            albedo = albedo + ink[:, None] * (mark.ink - albedo)
        return albedo
