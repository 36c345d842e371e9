"""Cloth cut out of photographs by the bundled network, rendered scenes, and its training."""

import numpy as np
import pytest
from safetensors.torch import load_file

from common.errors import InputError
from data.dataset import cloth
from data.dataset.cloth import ClothNetwork
from data.dataset.off_axis import silhouette
from data.pictures.cut import BUNDLED, cut_cloth, outline_of_cloth
from data.pictures.reading import Photograph, decoded
from data.render import textures
from data.render.phone import exposed
from data.render.scenery import Lamp, Scenery
from sim.draping import drape
from sim.material import Fabric
from sim.rig import DISC_RIG

HEIGHT, ABOVE = 0.15, 0.8  # m, of the plate, and of the camera above it
COUNT, HALF = 420, 0.19  # pixels, and m from the middle to the picture's border


@pytest.fixture(scope="module")
def shape():
    return drape(Fabric(alpha=[25e-6, 18e-6, 20e-6], beta=[-20e-9] * 3, density=0.15),
                 rig=DISC_RIG, edge=9e-3)


def scene(shape, surface, table, *, lamp: float = 1.0, seed: int = 0) -> Photograph:
    """A picture from straight above, a lamp at the side, on a plain table without a mat."""
    rng = np.random.default_rng(seed)
    random = Scenery.random(
        shape.positions + np.array([0, 0, HEIGHT]), shape.rest, shape.faces, rng, mat=None,
        plate_radius=DISC_RIG.plate_radius, plate_height=HEIGHT, clutter=False,
        surface=textures.plain(surface, rng, depth=0.0))
    plain = Scenery(random.cloth, random.rest, random.faces, random.surface,
                    textures.plain(table, rng, depth=0.02), None, (0.04, 0.85), np.ones(3),
                    random.things, [Lamp(np.array([0.8, 0.3, 1.2]), 0.1, lamp)])
    steps = (np.arange(COUNT) - (COUNT - 1) / 2) * (2 * HALF / COUNT)
    plane = np.dstack([*np.meshgrid(steps, -steps), np.full((COUNT, COUNT), HEIGHT)])
    eye = np.array([0, 0, HEIGHT + ABOVE])
    rays = (plane - eye) / np.linalg.norm(plane - eye, axis=2, keepdims=True)
    light, _ = plain.seen(eye, rays, rng)
    return Photograph(decoded(exposed(light, rng, blur=0.8) / 255.0),
                      np.zeros((COUNT, COUNT), bool))


def place() -> dict:
    pixel = 2 * HALF / COUNT
    middle = (COUNT - 1) / 2
    return {"to_pixels": np.array([[1 / pixel, 0, middle], [0, -1 / pixel, middle], [0, 0, 1.0]]),
            "plate": DISC_RIG.plate_radius, "reach": DISC_RIG.reach, "known": True}


def off_mm(shape, line: np.ndarray) -> np.ndarray:
    """Distances of a hem's points, mm, from the true outline along their azimuths."""
    x, y = ((line - (COUNT - 1) / 2) * [1, -1] * (2 * HALF / COUNT)).T
    true = silhouette(shape.positions, shape.mesh.edges, np.zeros(2), ABOVE, azimuths=720)
    at = np.interp(np.arctan2(y, x), np.arange(720) * (np.pi / 360), true, period=2 * np.pi)
    return 1e3 * (np.hypot(x, y) - at)


@pytest.mark.parametrize(("surface", "table"), [
    (np.array([0.5, 0.1, 0.1]), 0.7), (0.03, 0.6), (0.8, 0.15)], ids=["red", "black", "white"])
def test_the_hem_of_rendered_cloth_is_exact_to_half_a_millimetre(shape, surface, table):
    cut = outline_of_cloth(scene(shape, surface, table), **place())
    off = off_mm(shape, cut.hem)
    assert np.sqrt(np.square(off).mean()) < 0.5 and np.abs(off).max() < 3
    steps = np.linalg.norm(np.diff(cut.hem, axis=0), axis=1)
    assert 0.6 < steps.mean() < 1.4 and (cut.error > 0).all()


def test_what_hides_the_hem_makes_its_error_larger(shape):
    clear, alike = (scene(shape, 0.4, table, lamp=0.0) for table in (0.05, 0.4))
    known = outline_of_cloth(clear, **place())
    try:
        doubtful = cut_cloth(alike, **place())
    except InputError as error:
        assert "differs from its ground" in str(error)
    else:
        assert np.quantile(doubtful.error, 0.9) > 2 * np.quantile(known.error, 0.9)


def test_a_plate_that_is_larger_than_its_picture_is_refused(shape):
    where = place()
    where["to_pixels"] = where["to_pixels"] @ np.diag([3, 3, 1.0])
    with pytest.raises(InputError, match="pixels of the file, more than"):
        cut_cloth(scene(shape, 0.4, 0.1), **where)


def test_textures_are_albedo_and_repeat_with_their_seed():
    places = np.random.default_rng(0).uniform(-0.2, 0.2, (500, 2))
    for make in (lambda rng: textures.cloth(rng)[1], textures.table):
        for seed in range(12):
            one, again = (make(np.random.default_rng(seed))(places) for _ in range(2))
            assert one.shape == (500, 3) and (one > 0).all() and (one < 1).all()
            np.testing.assert_array_equal(one, again)
    picture = np.zeros((4, 6, 3)) + np.arange(6)[:, None] / 10 + 0.1
    mirrored = textures.of_picture(picture, 1e-3)(np.array([[0.5e-3, 0], [-0.5e-3, 0]]))
    np.testing.assert_allclose(mirrored[0], mirrored[1])


def test_the_network_is_trained_alike_twice_and_stored_small(cloth_dataset, tmp_path, capsys):
    files = [tmp_path / name for name in ("first.safetensors", "second.safetensors")]
    for file in files:
        cloth.main([f"data={cloth_dataset}", f"pictures={tmp_path / 'pictures'}", f"out={file}",
                    "shards=2", "scenes=1", "epochs=2", "workers=1"])
    assert files[0].read_bytes() == files[1].read_bytes()
    assert len(files[0].read_bytes()) == len(BUNDLED.read_bytes()) < 2_000_000
    ClothNetwork().load_state_dict(load_file(files[0]), strict=False)
    assert "of 2 shards are finished" in capsys.readouterr().out
