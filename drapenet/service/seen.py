"""Tasks of the process that reads photographs before an estimate, so that the web process reads
none."""

import base64
from functools import cache
from pathlib import Path
from typing import Any

from common.errors import InputError
from common.findings import records
from common.workers import end_with_parent

LOOK = ".photograph-"  # beginning of the name of a folder with a photograph
MAX_SIDE = 1000  # pixels, of the picture that is shown
_QUALITY = 85  # of its JPEG


def prepare() -> None:
    """Import and load what the first photograph needs, a second's work."""
    end_with_parent()
    import numpy as np

    import data.captures.seen  # noqa: F401
    from common.graphs import bundled_graph
    from data.captures import hem, off_axis
    from data.pictures import cut, mat

    for weights in (*cut.BUNDLED.values(), hem.BUNDLED, off_axis.BUNDLED):
        bundled_graph(weights)
    for name in mat.MATS:
        for ground in ("white", mat.CODE):
            mat.printed_at(name, np.zeros((1, 1, 2)), ground)


def photograph_as_read(folder: Path) -> dict[str, Any]:
    """What is found in the photograph of a capture folder, in pixels of a picture of it.

    ``picture`` is a JPEG as a data URL, of ``width`` and ``height``; ``scale`` is the number of
    pixels of a row of the file to each. Coordinates are those of the centres of pixels, from 0 on.
    """
    import cv2
    import numpy as np

    from data.captures.seen import seen_photograph

    try:
        seen = seen_photograph(folder)
    except InputError as error:
        raise error.within(folder) from None
    high, wide = seen.picture.shape[:2]
    share = min(1.0, MAX_SIDE / max(high, wide))
    width, height = round(share * wide), round(share * high)
    small = cv2.resize(seen.picture, (width, height), interpolation=cv2.INTER_AREA)
    coded = cv2.imencode(".jpg", small[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]

    def drawn(path: np.ndarray | None) -> list | None:
        return None if path is None else np.round((path + 0.5) * share - 0.5, 1).tolist()

    plate, outline = None, seen.outline
    if seen.plate:
        x, y, diameter = seen.plate
        plate = {"x": round((x + 0.5) * share - 0.5, 2), "y": round((y + 0.5) * share - 0.5, 2),
                 "diameter": round(diameter * share, 2)}
    return {
        "picture": "data:image/jpeg;base64," + base64.b64encode(coded.tobytes()).decode(),
        "width": width, "height": height, "scale": seen.factor * wide / width,
        "plate": plate, "centred": seen.centred, "movable": seen.movable,
        "outline": drawn(seen.hem), "specimen": drawn(seen.specimen), "warp": drawn(seen.warp),
        "cameras": drawn(seen.cameras), "next_camera": drawn(seen.next_camera),
        "unclear": [drawn(path) for path in seen.unclear],
        "drape_coefficient_percent":
            round(100 * outline.drape_coefficient, 1) if outline else None,
        "nodes": outline.folds if outline else None,
        "warnings": records(outline.warnings) if outline else [],
        "refusal": str(InputError(seen.refusal).within(folder)) or None}


@cache
def mat_pdf(mat: str, paper: str, ground: str) -> bytes:
    """PDF of a mat, to be printed at 100 %."""
    from data.pictures.mat import mat_pages

    return mat_pages(mat, paper, ground)
