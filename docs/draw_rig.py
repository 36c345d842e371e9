"""The drawings of docs/rig.md: ``python docs/draw_rig.py`` writes docs/images/rig*.png."""

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, Polygon, Rectangle

PITCH = math.radians(35.0)
DISTANCE = 527.0  # mm
CLOTH, BODY = "C3", "0.35"
IMAGES = Path(__file__).parent / "images"


def main() -> None:
    """Draw the testers, lengths in mm, the plate's centre the origin."""
    figure = Figure(figsize=(8.4, 4.6), layout="constrained")
    _side(figure.subplots())
    figure.savefig(IMAGES / "rig.png", dpi=110)
    figure = Figure(figsize=(8.4, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1, 1))
    _photograph(left)
    _from_above(right)
    figure.savefig(IMAGES / "rig_above.png", dpi=110)


def _side(axes: Axes) -> None:
    """Tester and depth camera from the side."""
    axes.add_patch(Rectangle((-620, -262), 1000, 12, color="0.8"))
    axes.add_patch(Rectangle((-120, -250), 240, 20, color="0.65"))
    axes.add_patch(Rectangle((-25, -230), 50, 226, color="0.75"))
    axes.add_patch(Rectangle((-50, -4), 100, 4, color="0.4"))
    _hem(axes, ((0, 2), (45, 2), (62, -8), (80, -50), (92, -98)))
    x, z = -DISTANCE * math.cos(PITCH), DISTANCE * math.sin(PITCH)
    along, up = (math.cos(PITCH), -math.sin(PITCH)), (math.sin(PITCH), math.cos(PITCH))
    corners = [(-45, -18), (25, -18), (25, 18), (-45, 18)]
    axes.add_patch(Polygon([(x + a * along[0] + b * up[0], z + a * along[1] + b * up[1])
                            for a, b in corners], color=BODY))
    for foot in (-60, 60):
        axes.plot([x - 10, x - 10 + foot], [z - 20, -250], color="0.5")
    axes.annotate("", (-4, 4), (x + 30 * along[0], z + 30 * along[1]),
                  arrowprops={"arrowstyle": "<->", "ls": "--"})
    axes.plot([x, x + 190], [z, z], ":", color="0.4")
    axes.add_patch(Arc((x, z), 300, 300, theta1=-math.degrees(PITCH), theta2=0, color="0.4"))
    axes.annotate("", (0, -225), (0, -2), arrowprops={"arrowstyle": "<->"})
    _write(axes, (
        ((-190, 165), "400 to 700 mm from lens to plate"),
        ((x + 160, z - 50), "25° to 50°"),
        ((x - 60, z + 45), "depth camera on a tripod, looks down at the plate"),
        ((62, 8), "plate, 100 mm across, level"),
        ((100, -92), "specimen, 300 mm × 300 mm,\ncentred, sides cut along the yarns"),
        ((32, -178), "column, thinner than the plate,\n200 mm or more from plate to table"),
        ((130, -246), "turntable, turned between the views")))
    _finish(axes, (-620, 380), (-268, 380))


def _photograph(axes: Axes) -> None:
    """Cusick tester and camera from the side; the distance of the camera is not to scale."""
    axes.add_patch(Rectangle((-260, -215), 520, 15, color="#ffe9a8", ec="0.5"))
    axes.add_patch(Rectangle((-90, -200), 180, 196, color="0.75"))
    _hem(axes, ((0, 2), (88, 2), (108, -12), (122, -48)))
    axes.add_patch(Rectangle((-30, 420), 60, 35, color=BODY))
    axes.add_patch(Rectangle((-12, 405), 24, 15, color=BODY))
    for side in (-1, 1):
        axes.plot([0, 122 * side], [405, -48], ":", color="0.4", lw=1)
    axes.annotate("", (0, 4), (0, 405), arrowprops={"arrowstyle": "<->", "ls": "--"})
    _write(axes, (
        ((45, 420), "camera, straight above\nthe plate's centre"),
        ((60, 235), "camera_height_mm:\nlens to plate, 1 m or more\n(shown shorter)"),
        ((126, 4), "disc, 300 mm across"),
        ((-82, -120), "support,\n180 mm across"),
        ((-250, -260), "plain ground, or light from below (light box)")))
    axes.set_title("one photograph from above", fontsize=10)
    _finish(axes, (-265, 335), (-265, 470))


def _from_above(axes: Axes) -> None:
    """The angle of the warp and the turn of the table, as the pictures show them."""
    around = np.linspace(0, 2 * np.pi, 400)
    radius = 125 + 17 * np.cos(6 * around + 0.6)
    axes.fill(radius * np.cos(around), radius * np.sin(around), color=CLOTH, alpha=0.25)
    axes.add_patch(Circle((0, 0), 90, fill=False, color="0.4"))
    axes.plot([0, 190], [0, 0], ":", color="0.4")
    warp = math.radians(30)
    axes.plot(*np.outer((math.cos(warp), math.sin(warp)), (-135, 135)), color=CLOTH, lw=2)
    axes.add_patch(Arc((0, 0), 130, 130, theta1=0, theta2=30, color="k"))
    axes.add_patch(Arc((0, 0), 380, 380, theta1=200, theta2=250, color="0.4"))
    end = math.radians(250)
    axes.annotate("", (190 * math.cos(end + 0.06), 190 * math.sin(end + 0.06)),
                  (190 * math.cos(end), 190 * math.sin(end)),
                  arrowprops={"arrowstyle": "->", "color": "0.4"})
    axes.add_patch(Rectangle((-22, -270), 44, 28, color=BODY))
    axes.add_patch(Rectangle((-9, -242), 18, 12, color=BODY))
    _write(axes, (
        ((152, 6), "0°"), ((-10, 196), "90°"),
        ((70, 14), "30°"), ((105, 92), "warp: here\nwarp_direction_deg: 30"),
        ((-265, -222), "the table turns\ncounter-clockwise"),
        ((32, -268), "the depth camera stands here;\na photograph has its lower edge here")))
    axes.set_title("seen from above", fontsize=10)
    _finish(axes, (-270, 300), (-285, 230))


def _hem(axes: Axes, points: tuple[tuple[float, float], ...]) -> None:
    for side in (-1, 1):
        axes.plot([side * x for x, _ in points], [z for _, z in points], color=CLOTH, lw=3)


def _write(axes: Axes, texts: tuple[tuple[tuple[float, float], str], ...]) -> None:
    for place, text in texts:
        axes.text(*place, text, ha="left", va="bottom", fontsize=9)


def _finish(axes: Axes, across: tuple[float, float], up: tuple[float, float]) -> None:
    axes.set(xlim=across, ylim=up, aspect="equal")
    axes.axis("off")


if __name__ == "__main__":
    main()
