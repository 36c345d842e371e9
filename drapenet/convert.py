"""Files for all tools from values of testers, without any picture.

    python -m drapenet.convert values=twill.yaml [export=jfab,u3m] [out=DIR]
    python -m drapenet.convert density_g_m2=210 known='{bending_length_mm: {warp: 22, weft: 18}}'

Prints the estimate with its intervals and what was assumed, and writes ``estimate.json``, the
report and the tools' files to ``out``. Keys of ``values.yaml``: ``docs/data_format.md``.
"""

from dataclasses import make_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from common.arguments import require
from common.command import command
from common.documents import read_yaml, require_file_in
from common.files import folder_named, locked
from drapenet.config import EstimateOptions
from drapenet.measured.values import FILE, ValuesDescription, ValueSet

if TYPE_CHECKING:
    from drapenet.result.estimate import Estimate

KEYS = tuple(ValuesDescription.model_fields)
ConvertConfig = make_dataclass("ConvertConfig", [
    *((key, str) for key in ("values", "out", "export", "checkpoint")),
    *((key, object) for key in KEYS)])
"""``configs/convert.yaml``; the values are checked as those of a file."""


@command("convert", ConvertConfig)
def main(config: Any) -> None:
    """Convert the values of a file and of the command line."""
    stated = {key: value for key in KEYS if (value := getattr(config, key)) is not None}
    convert(config.values, config.out, config.export, checkpoint=config.checkpoint, shown=True,
            **stated)


def convert(
    values: str | Path = "", out: str | Path = "", export: str = "all", *,
    checkpoint: str | Path = "", shown: bool = False, **stated: Any,
) -> "Estimate":
    """Estimate a fabric from values of testers alone, and write it for other tools.

    Args:
        values: a ``values.yaml``, or its folder.
        out: folder of estimate, report and files; empty: ``outputs/convert/FABRIC``.
        export: names of ``docs/exports.md`` with commas, ``all``, or empty for none.
        checkpoint: FILE.safetensors of ``train.py``; empty: the bundled one.
        shown: whether the estimate is printed.
        stated: keys of ``values.yaml``, in place of those of the file, such as
            ``density_g_m2=210, known={"bending_length_mm": {"warp": 22, "weft": 18}}``.

    InputError for values that are no fabric's.
    """
    from drapenet.export.formats import export_beside, targets_named
    from drapenet.fabric.entries import plain_name
    from drapenet.fabric.estimate import estimate_fabric
    from drapenet.fabric.sources import Source
    from drapenet.network.checkpoint import read_header
    from drapenet.result.files import ESTIMATE, require_output
    from drapenet.result.terminal import print_estimate

    require(values=(values, str | Path), out=(out, str | Path), export=(export, str),
            checkpoint=(checkpoint, str | Path))
    names, place = targets_named(export, "export") if export else [], Path(values or "values")
    file = require_file_in(place, FILE, ValuesDescription.content) if place.is_dir() else place
    content = {**(read_yaml(file) if values else {}), **stated}
    measured = ValueSet.of(ValuesDescription.of(content, file if values else ""), place)
    name = plain_name(measured.labels.fabric or place.stem)
    folder = folder_named(str(out or Path("outputs/convert") / name))
    with locked(folder):
        require_output(folder, [place])
        found = estimate_fabric(
            [Source(place=measured, kind=measured.name)], read_header(checkpoint),
            EstimateOptions(), folder=folder,
            on_estimate=print_estimate if shown else lambda document, folder: None)
        line = export_beside(folder / ESTIMATE, names)
        if shown and names:
            print(line)
    return found.estimate


if __name__ == "__main__":
    main()
