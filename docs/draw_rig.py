"""The drawing of docs/rig.md: ``python docs/draw_rig.py`` writes docs/images/rig.png."""

import math
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle

PITCH = math.radians(35.0)
DISTANCE = 527.0  # mm


def main() -> None:
    """Draw the tester from the side, lengths in mm, the plate's centre the origin."""
    figure = Figure(figsize=(8.4, 4.6), layout="constrained")
    axis = figure.subplots()
    axis.add_patch(Rectangle((-620, -262), 1000, 12, color="0.8"))
    axis.add_patch(Rectangle((-120, -250), 240, 20, color="0.65"))
    axis.add_patch(Rectangle((-25, -230), 50, 226, color="0.75"))
    axis.add_patch(Rectangle((-50, -4), 100, 4, color="0.4"))
    for side in (-1, 1):
        axis.plot([0, 45 * side, 62 * side, 80 * side, 92 * side], [2, 2, -8, -50, -98], color="C3",
                  lw=3)
    x, z = -DISTANCE * math.cos(PITCH), DISTANCE * math.sin(PITCH)
    along, up = (math.cos(PITCH), -math.sin(PITCH)), (math.sin(PITCH), math.cos(PITCH))
    corners = [(-45, -18), (25, -18), (25, 18), (-45, 18)]
    axis.add_patch(Polygon([(x + a * along[0] + b * up[0], z + a * along[1] + b * up[1])
                            for a, b in corners], color="0.35"))
    for foot in (-60, 60):
        axis.plot([x - 10, x - 10 + foot], [z - 20, -250], color="0.5")
    axis.annotate("", (-4, 4), (x + 30 * along[0], z + 30 * along[1]),
                  arrowprops={"arrowstyle": "<->", "ls": "--"})
    axis.plot([x, x + 190], [z, z], ":", color="0.4")
    for place, text, side in (
        ((-215, 185), "400 to 700 mm", "left"),
        ((x + 60, z + 10), "25° to 50° below the horizontal", "left"),
        ((x - 60, z + 45), "depth camera on a tripod", "left"),
        ((62, 8), "plate, 100 mm across, level", "left"),
        ((100, -92), "specimen, 300 mm × 300 mm,\ncentred, sides cut along the yarns", "left"),
        ((32, -178), "column, thinner than the plate, so high\nthat the hem hangs free (200 mm)",
         "left"),
        ((130, -246), "turntable, turned between the views", "left"),
    ):
        axis.text(*place, text, ha=side, va="bottom", fontsize=9)
    axis.set(xlim=(-620, 380), ylim=(-268, 380), aspect="equal")
    axis.axis("off")
    figure.savefig(Path(__file__).parent / "images" / "rig.png", dpi=110)


if __name__ == "__main__":
    main()
