"""What a photograph of a drape shows: cloth, tester, mat, table and things, and the light on them.

Lengths are m over the table or the mat, whose x-axis is along its arrow; the plate's axis is z.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache

import cv2
import numpy as np
import trimesh
from scipy.ndimage import map_coordinates

from common.types import Faces, Metres, Points, RestPoints
from data.pictures.mat import CODE, GROUNDS, MATS, mat_picture, mat_pixels, on_ground
from data.pictures.reading import decoded
from data.render import textures
from data.render.rays import Hits, RayScene
from data.render.textures import Texture

_GAP = 0.4e-3  # m, of plate and stand from the cloth
_FAR = 5.0  # m, of the table's border
_SKY, _LAMP_RAYS = 12, 6  # directions and points that shadows are averaged over
_COARSE = 4  # pixels between places at which the sky is seen
_SKIN = np.array([0.45, 0.28, 0.2])
_CLOTH, _TABLE = 0, 1  # numbers of meshes
_RIMMED, _DRAWN = 0.1, 0.05  # shares of scenes
_FINE, _GAIN = 3, 0.5  # pixels of a mat's picture averaged; largest gain of dots, of its pixels


@dataclass(frozen=True)
class Thing:
    """A mesh with its surface; ``over``: lies on the cloth of the plate."""

    points: Points
    faces: Faces
    texture: Texture
    over: bool = False


@dataclass(frozen=True)
class Lamp:
    """A lamp at a place (3,), of a size, m, and its light over that of the sky."""

    place: np.ndarray
    size: Metres
    strength: float


@dataclass(frozen=True)
class Scenery:
    """A drape and all around it.

    Attributes:
        cloth, rest: points (V, 3) and the flat specimen's (V, 2).
        mat, mat_light: its name, None for a bare table, and albedo of ink and paper.
        mat_ground: light (3,) of the mat's ground, over that of paper.
        gain: of the dots of a mat with the code, in its pixels; None of a plain one.
        through: share of the light that passes through the cloth, and ``holes``: where (N,) of
            places (N, 2) of the flat specimen all does.
        gloss: strength and exponent of its highlights (Blinn and Phong).
        glow: light of the table itself, such as that of a light pad.
        sky: its light over that of an even room.
        shaded: whether light depends on the place; in a drawn or a copied picture it does not.
        kind: what results say of it.
    """

    cloth: Points
    rest: RestPoints
    faces: Faces
    surface: Texture
    table: Texture
    mat: str | None
    mat_light: tuple[float, float]
    mat_ground: np.ndarray
    things: list[Thing]
    lamps: list[Lamp]
    gain: float | None = None
    through: float = 0.0
    holes: Callable[[np.ndarray], np.ndarray] | None = None
    gloss: tuple[float, float] = (0.0, 1.0)
    glow: float = 0.0
    sky: float = 1.0
    shaded: bool = True
    kind: dict = field(default_factory=dict)

    @classmethod
    def random(
        cls, cloth: Points, rest: RestPoints, faces: Faces, rng: np.random.Generator, *,
        mat: str | None, plate_radius: Metres, plate_height: Metres, clutter: bool = True,
        sheets: bool = True, ground: str | None = None, surface: Texture | None = None
    ) -> "Scenery":
        """A random scene around a drape; ``clutter``: with things that lie about, and ``sheets`` of
        paper among them, also over a mat; ``ground``: of the mat, and ``surface`` of the cloth, in
        place of random ones."""
        pattern, random_surface = textures.cloth(rng)
        reach = float(np.hypot(*rest.T).max())
        things = _tester(rng, plate_radius, plate_height, clutter=clutter)
        if clutter:
            below = min(plate_height, float(cloth[:, 2].min()))
            things += _clutter(rng, reach, below, sheets=sheets)
        lamps = [_lamp(rng) for _ in range(rng.choice(3, p=[0.25, 0.55, 0.2]))]
        rare = rng.random(5)
        if rare[3] < _RIMMED and surface is None:
            edge = textures.colour(rng)  # frayed or worn
            random_surface = textures.bordered(random_surface, rest, rng.uniform(1e-3, 6e-3), edge)
        return cls(
            cloth, rest, faces, surface or random_surface, textures.table(rng), mat,
            (rng.uniform(0.02, 0.1), rng.uniform(0.7, 0.9)), _mat_ground(ground, rng), things,
            lamps, round(rng.uniform(0, _GAIN), 1) if ground == CODE else None,
            through=rng.uniform(0.05, 0.5) if rare[0] < 0.12 else 0.0,
            gloss=(rng.uniform(0.05, 0.6), rng.uniform(4, 40)) if rare[1] < 0.25 else (0.0, 1.0),
            glow=rng.uniform(0.5, 3.0) if rare[2] < 0.06 else 0.0,
            sky=float(np.exp(rng.uniform(np.log(0.15), 0.0))) if lamps else 1.0,
            shaded=not clutter or rare[4] > _DRAWN,
            kind={"pattern": "stated" if surface else pattern, "lamps": len(lamps),
                  "things": len(things)})

    def seen(
        self, eye: np.ndarray, rays: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Light (H, W, 3) along rays (H, W, 3) from an eye (3,), and which meet the specimen, also
        behind other things."""
        meshes = [(self.cloth, self.faces), _square(_FAR),
                  *((one.points, one.faces) for one in self.things)]
        scene = RayScene(*meshes)
        hits = scene.cast(eye, rays)
        specimen = RayScene(meshes[_CLOTH]).cast(eye, rays).mesh == 0
        for number, thing in enumerate(self.things, 2):
            specimen |= thing.over & (hits.mesh == number)
        light = self._shaded(scene, meshes, hits, eye, rays, rng)
        if self.through or self.holes:
            behind = RayScene((np.zeros((3, 3)), np.array([[0, 1, 2]])), *meshes[1:])
            seen = self._shaded(scene, meshes, behind.cast(eye, rays), eye, rays, rng)
            shown = hits.mesh == _CLOTH
            through = self.through * shown
            if self.holes:
                through[shown] += self.holes(_between(self.rest, self.faces, hits, shown))
            light += np.minimum(through, 1)[..., None] * (seen - light)
        return light, specimen

    def _shaded(self, scene: RayScene, meshes: list, hits: Hits, eye: np.ndarray,
                rays: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        places = eye + np.minimum(hits.distance, 20)[..., None] * rays
        albedo = np.zeros(rays.shape)
        shown = hits.mesh == _TABLE
        albedo[shown] = self._ground(places[shown][:, :2])
        shown = hits.mesh == _CLOTH
        albedo[shown] = self.surface(_between(self.rest, self.faces, hits, shown))
        for number, thing in enumerate(self.things, 2):
            shown = hits.mesh == number
            albedo[shown] = thing.texture(places[shown][:, :2] + places[shown][:, 2:])
        normals = _normals(hits, meshes, rays)
        light = albedo * self._light(scene, hits, places, normals, rng)[..., None]
        light += (self.glow * (hits.mesh == _TABLE))[..., None] * albedo
        strength, power = self.gloss
        if strength:
            for lamp in self.lamps:
                half = _unit(lamp.place - places) - _unit(rays)
                shine = np.maximum((_unit(half) * normals).sum(axis=2), 0) ** power
                light += (strength * lamp.strength * shine * (hits.mesh == _CLOTH))[..., None]
        return light

    def _ground(self, places: np.ndarray) -> np.ndarray:
        """Albedo (N, 3) of table and mat at places (N, 2)."""
        albedo = self.table(places)
        if self.mat:
            lay_mat(albedo, places, self.mat, self.mat_light, self.mat_ground, self.gain)
        return albedo

    def _light(self, scene: RayScene, hits: Hits, places: np.ndarray, normals: np.ndarray,
               rng: np.random.Generator) -> np.ndarray:
        """Light (H, W) at places with ``normals``: of the sky, and of lamps."""
        if not self.shaded:
            return np.ones(hits.mesh.shape)
        surface = np.where(hits.mesh == _CLOTH, 1, 0)
        coarse = slice(None, None, _COARSE), slice(None, None, _COARSE)
        there, up = places[coarse] + 1e-3 * normals[coarse], normals[coarse]
        sky = np.zeros(there.shape[:2])
        for k in range(_SKY):
            height, around = (k + 0.5) / _SKY, k * 2.399963
            way = np.array([np.sqrt(1 - height**2) * np.cos(around),
                            np.sqrt(1 - height**2) * np.sin(around), height])
            spread = way + rng.normal(0, 0.2, there.shape)
            free = ~np.isfinite(scene.cast(there, spread).distance)
            sky += free * np.maximum(up @ way, 0) * 2 / _SKY
        total = 0.5 * self.sky * _spread(sky, surface, _COARSE)
        half = slice(None, None, 2), slice(None, None, 2)
        there = places[half] + 1e-3 * normals[half]
        for lamp in self.lamps:
            lit = np.zeros(there.shape[:2])
            for _ in range(_LAMP_RAYS):
                way = _unit(lamp.place + lamp.size * rng.normal(0, 0.5, there.shape) - there)
                lit += ~np.isfinite(scene.cast(there, way).distance) / _LAMP_RAYS
            slope = np.maximum((normals * _unit(lamp.place - places)).sum(axis=2), 0)
            total = total + 0.5 * lamp.strength * slope * _spread(lit, surface, 2)
        return total


@cache
def _code_printed(name: str, gain: float) -> np.ndarray:
    """The mat with its code (H, W) float32, share of paper's light in three of its pixels along a
    side; ``gain``: how much of a pixel more is black along edges."""
    page = mat_picture(name, CODE)
    grown = cv2.erode(page, np.ones((3, 3), np.uint8))
    height, width = (n // _FINE for n in page.shape)
    mixed = cv2.addWeighted(page, (1 - gain) / 255, grown, gain / 255, 0, dtype=cv2.CV_32F)
    return cv2.resize(mixed[: height * _FINE, : width * _FINE], (width, height),
                      interpolation=cv2.INTER_AREA)


def lay_mat(albedo: np.ndarray, places: np.ndarray, mat: str, light: tuple[float, float],
            ground: np.ndarray, gain: float | None = None) -> None:
    """Put a mat on albedo (N, 3) at places (N, 2), m; ``light``: of ink and paper, ``ground`` (3,):
    of the ground, or of the paper with the code, over it, ``gain`` of the code's dots."""
    columns, rows = mat_pixels(mat, places)
    nearest = np.rint([rows, columns]).astype(int)
    on = (nearest >= 0).all(axis=0) & (nearest.T < MATS[mat].shape).all(axis=1)
    if gain is None:
        share = decoded(mat_picture(mat)[tuple(nearest[:, on])] / 255.0)
    else:
        fine = [(one[on] + 0.5) / _FINE - 0.5 for one in (rows, columns)]
        share = map_coordinates(_code_printed(mat, gain), fine, order=1, mode="nearest")
    ink, paper = light
    albedo[on] = (ink + (paper - ink) * share)[:, None]
    albedo[on if gain is not None else on_ground(mat, places)] *= ground


def _tester(
    rng: np.random.Generator, plate_radius: Metres, plate_height: Metres, *, clutter: bool
) -> list[Thing]:
    """Stand and plate, and sometimes its base, and the upper disc on the cloth."""
    def cylinder(radius: Metres, low: Metres, high: Metres, *, over: bool = False) -> Thing:
        mesh = trimesh.creation.cylinder(radius, high - low, sections=64)
        return Thing(mesh.vertices + np.array([0, 0, (low + high) / 2]), mesh.faces,
                     textures.plain(textures.colour(rng), rng), over)

    top = plate_height - _GAP
    things = [cylinder(rng.uniform(0.2, 0.9) * plate_radius, 0, top - 1e-3),
              cylinder(plate_radius - _GAP, top - 3e-3, top)]
    if clutter and rng.random() < 0.3:
        things.append(cylinder(rng.uniform(0.3, 1.1) * plate_radius, 0,
                               min(rng.uniform(3e-3, 0.03), 0.3 * plate_height)))
    if clutter and rng.random() < 0.2:
        thick = rng.uniform(1e-3, 0.015)
        things.append(cylinder(rng.uniform(0.85, 1.0) * plate_radius, plate_height + 5e-4,
                               plate_height + thick, over=True))
        things.append(cylinder(rng.uniform(2e-3, 0.015), plate_height + thick,
                               plate_height + thick + rng.uniform(2e-3, 0.03), over=True))
    return things


def _clutter(rng: np.random.Generator, reach: Metres, below: Metres, *, sheets: bool
             ) -> list[Thing]:
    """Things on the table beside the drape or under it, ``below`` the lowest cloth, and a hand."""
    things = []
    for _ in range(rng.choice([0, 0, 1, 2, 4])):
        around, far = rng.uniform(0, 2 * np.pi), reach * rng.uniform(0.75, 1.6)
        long = np.exp(rng.uniform(np.log(0.01), np.log(0.12)))
        high = float(np.exp(rng.uniform(np.log(1e-3), np.log(0.1))))
        if far - long < 1.05 * reach:
            high = min(high, below - 2e-3)
        if high < 5e-4:
            continue
        if rng.random() < 0.5:
            mesh = trimesh.creation.box([long, long * rng.uniform(0.05, 1), high])
        else:
            mesh = trimesh.creation.cylinder(0.5 * long, high)
        cos, sin = np.cos(turn := rng.uniform(0, np.pi)), np.sin(turn)
        points = mesh.vertices @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1.0]])
        points = points + np.array([far * np.cos(around), far * np.sin(around), high / 2])
        things.append(Thing(points, mesh.faces, textures.plain(textures.colour(rng), rng)))
    for _ in range(sheets * rng.choice([0, 0, 0, 1, 3])):  # and stickers, also under the drape
        size = np.exp(rng.uniform(np.log(0.02), np.log(0.35), 2))
        place = reach * rng.uniform(0.4, 1.4) * _unit(rng.normal(size=2))
        mesh = trimesh.creation.box([*size, 6e-4])
        turn3 = trimesh.transformations.rotation_matrix(rng.uniform(0, np.pi), [0, 0, 1])[:3, :3]
        things.append(Thing(mesh.vertices @ turn3.T + [*place, 3e-4], mesh.faces,
                            textures.plain(textures.colour(rng), rng)))
    if rng.random() < 0.08:  # fingers, from outside
        around = rng.uniform(0, 2 * np.pi)
        way = np.array([np.cos(around), np.sin(around)])
        tip, skin = 1.06 * reach, _SKIN * np.exp(rng.normal(0, 0.4))
        for aside in (-0.02, 0.0, 0.02):
            mesh = trimesh.creation.capsule(0.3, 9e-3)
            turn3 = trimesh.geometry.align_vectors([0, 0, 1], [*way, 0])[:3, :3]
            start = [*(way * (tip + rng.uniform(0, 0.02)) + aside * way[::-1] * [-1, 1]),
                     rng.uniform(0.01, 0.06)]
            things.append(Thing(mesh.vertices @ turn3.T + start, mesh.faces,
                                textures.plain(skin, rng)))
    return things


def _mat_ground(ground: str | None, rng: np.random.Generator) -> np.ndarray:
    """Of a name of GROUNDS; else white, mostly, or dark."""
    if ground is not None:
        return decoded(np.array(GROUNDS[ground]) / 255)
    if rng.random() < 0.85:
        return np.ones(3)
    return rng.uniform(0.12, 0.5) * np.exp(rng.choice([0.0, 0.5]) * rng.normal(size=3))


def _lamp(rng: np.random.Generator) -> Lamp:
    """A lamp or a window, from nearly above to the side."""
    around, aside, high = rng.uniform(0, 2 * np.pi), rng.uniform(0.05, 1.5), rng.uniform(0.6, 2.2)
    return Lamp(np.array([aside * np.cos(around), aside * np.sin(around), high]),
                float(np.exp(rng.uniform(np.log(0.01), np.log(0.8)))),
                float(np.exp(rng.uniform(np.log(0.25), np.log(3.0)))))


def _square(far: Metres) -> tuple[np.ndarray, np.ndarray]:
    points = far * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]])
    return points, np.array([[0, 1, 2], [0, 2, 3]])


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)


def _spread(values: np.ndarray, surface: np.ndarray, step: int) -> np.ndarray:
    """Values (H/step, W/step) of every ``step``-th pixel for all (H, W): smoothed on each surface,
    not from one to another."""
    size, total = surface.shape[::-1], np.zeros(surface.shape, np.float32)
    for k in (0, 1):
        mine = (surface[::step, ::step] == k).astype(np.float32)
        weighted, weight = (cv2.resize(cv2.GaussianBlur(one, (0, 0), 1.5), size) for one in
                            ((values * mine).astype(np.float32), mine))
        total += (surface == k) * weighted / np.maximum(weight, 1e-4)
    return total


def _between(values: np.ndarray, faces: Faces, hits: Hits, shown: np.ndarray) -> np.ndarray:
    """Values (V, C) of vertices, interpolated where hits (H, W) are ``shown``."""
    weights = hits.uv[shown]
    weights = np.column_stack([1 - weights.sum(axis=1), weights])
    return (weights[..., None] * values[faces[hits.face[shown]]]).sum(axis=1)


def _normals(hits: Hits, meshes: list, rays: np.ndarray) -> np.ndarray:
    """Normals (H, W, 3) towards the eye; those of cloth are smooth."""
    normals = np.zeros(rays.shape)
    for k, (vertices, faces) in enumerate(meshes):
        if not (shown := hits.mesh == k).any():
            continue
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        normals[shown] = (_between(mesh.vertex_normals, faces, hits, shown) if k == _CLOTH
                          else mesh.face_normals[hits.face[shown]])
    return _unit(normals) * -np.sign((normals * rays).sum(axis=2, keepdims=True))
