"""Draw discs of three stiffnesses for exports.md: ``python docs/draw_stiffness.py``."""

from pathlib import Path

from matplotlib.figure import Figure

from data.render.shade import shade
from sim import DISC_RIG, MICRO, Fabric, drape, drape_coefficient, fold_count

IMAGES = Path(__file__).parent / "images"
DENSITY = 0.2  # kg/m²
STIFFNESSES = (5, 20, 80)  # µN·m


def main() -> None:
    """Simulate and draw."""
    figure = Figure(figsize=(8, 2.7), layout="constrained")
    for axes, stiffness in zip(figure.subplots(1, len(STIFFNESSES)), STIFFNESSES, strict=True):
        cloth = drape(Fabric([stiffness * MICRO] * 3, density=DENSITY), rig=DISC_RIG, edge=5e-3)
        assert cloth.converged, cloth.message
        coefficient = drape_coefficient(cloth.positions, cloth.faces, DISC_RIG)
        axes.imshow(shade(cloth.positions, cloth.faces, plate_radius=DISC_RIG.plate_radius,
                          size=(320, 230), field=0.33))
        axes.set_title(f"{stiffness} µN·m: {100 * coefficient:.0f} %, "
                       f"{fold_count(cloth.positions, cloth.rest, DISC_RIG)} folds", fontsize=10)
        axes.axis("off")
    figure.savefig(IMAGES / "stiffness.png", dpi=100, metadata={"Software": None})


if __name__ == "__main__":
    main()
