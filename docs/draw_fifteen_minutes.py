"""The pictures of docs/fifteen_minutes.md: ``python docs/draw_fifteen_minutes.py`` writes
docs/images/fifteen_*. Photographs are rendered, as those of the experiment ``tension``."""

import io
import math
import tempfile
from pathlib import Path

import numpy as np
import yaml
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from PIL import Image

from data.render.pulled import MarkedStrip
from drapenet.measured.tension.folder import read_tension
from drapenet.measured.tension.preview import tension_figure

ROOT = Path(__file__).parents[1]
IMAGES = ROOT / "docs" / "images"
STRIPS = yaml.safe_load((ROOT / "examples" / "tension" / "twill" / "tension.yaml").read_text(
    encoding="utf-8"))
PHOTOGRAPHS = ("without.jpg", "with.jpg")
LENS = (26.0, 0.0)  # mm and distortion of the phone
SEED = 11  # of a plain cloth and a pen that differs from it


def main() -> None:
    """Draw all."""
    cut().savefig(IMAGES / "fifteen_cut.png", dpi=80)
    drape(ROOT / "examples" / "captures" / "twill_photograph" / "outline.jpg")
    figure = pulled()
    picture = io.BytesIO()
    figure.savefig(picture, dpi=75, format="png")
    Image.open(picture).convert("RGB").save(IMAGES / "fifteen_strip.jpg", quality=82)


def drape(file: Path) -> None:
    """The mat of a photograph of a drape."""
    picture = Image.open(file).convert("RGB")
    width, height = picture.size
    picture = picture.crop((round(0.2 * width), round(0.34 * height), round(0.82 * width),
                            round(0.7 * height)))
    picture.thumbnail((480, 480))
    picture.save(IMAGES / "fifteen_drape.jpg", quality=80)


def cut() -> Figure:
    """Pieces to be cut, lengths in mm."""
    figure = Figure(figsize=(7.5, 3.4), layout="constrained")
    axes = figure.subplots()
    axes.add_patch(Circle((150, 150), 150, facecolor="#dfe6ee", edgecolor="k"))
    axes.annotate("", (150, 250), (150, 60), arrowprops={"arrowstyle": "->", "lw": 1.5})
    axes.text(160, 150, "warp", rotation=90, va="center")
    axes.text(150, 20, "disc of 300", ha="center")
    for k, (name, gauge, angle) in enumerate((("warp", 200, 0), ("weft", 200, 90),
                                              ("bias", 100, 45))):
        left = 350 + 90 * k
        axes.add_patch(Rectangle((left, 0), 50, 300, facecolor="#dfe6ee", edgecolor="k"))
        for side in (-1, 1):
            axes.plot([left, left + 50], [150 + side * gauge / 2] * 2, color="#b5403a", lw=2)
        axes.annotate("", (left + 62, 150 + gauge / 2), (left + 62, 150 - gauge / 2),
                      arrowprops={"arrowstyle": "<->", "color": "#b5403a"})
        axes.text(left + 66, 150, f"{gauge}", color="#b5403a", va="center", rotation=90)
        middle = np.array([left + 25, 150])
        yarn = 18 * np.array([math.sin(math.radians(angle)), math.cos(math.radians(angle))])
        axes.annotate("", middle + yarn, middle - yarn, arrowprops={"arrowstyle": "->"})
        axes.text(left + 25, -8, name, ha="center", va="top")
    axes.text(465, 312, "strips of 50 × 300", ha="center")
    axes.set(xlim=(-5, 625), ylim=(-30, 335), aspect="equal")
    axes.set_axis_off()
    return figure


def pulled() -> Figure:
    """The strip along the bias without and with its weight, as it is read, and all loads."""
    rng = np.random.default_rng(SEED)
    bias = STRIPS["tension"][0]
    strain = bias["extension_mm"] / bias["gauge_mm"]
    size = {"gauge": 1e-3 * bias["gauge_mm"], "width": 1e-3 * bias["width_mm"]}
    strip = next(strip for strip in iter(lambda: MarkedStrip.random(rng, ground="grey", **size), 0)
                 if strip.kind["pattern"] == "plain")
    with tempfile.TemporaryDirectory() as name:
        for file, stretch in zip(PHOTOGRAPHS, (0.0, strain), strict=True):
            (Path(name) / file).write_bytes(strip.photograph(
                strip.pose(rng, LENS), rng, stretch=1 + stretch, narrow=1 - 0.7 * stretch,
                turn=math.pi / 2))
        read = dict(zip(("without", "with"), PHOTOGRAPHS, strict=True))
        entry = {key: value for key, value in bias.items() if key != "extension_mm"} | read
        (Path(name) / "tension.yaml").write_text(yaml.safe_dump(
            STRIPS | {"tension": [entry, *STRIPS["tension"][1:]]}), encoding="utf-8")
        tension = read_tension(name)
        return tension_figure(tension.strips, tension.photographs, tension.evidence)


if __name__ == "__main__":
    main()
