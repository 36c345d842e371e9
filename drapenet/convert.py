"""Files for all tools from values of testers, without any picture.

    python -m drapenet.convert values=twill.yaml [export=jfab,u3m] [out=DIR]
    python -m drapenet.convert density_g_m2=210 known='{bending_length_mm: {warp: 22, weft: 18}}'

Prints the estimate with its intervals and what was assumed, and writes ``estimate.json``, the
report and the tools' files to ``out``. Keys of ``values.yaml``: ``docs/data_format.md``.
"""

from collections.abc import Mapping
from dataclasses import asdict, make_dataclass
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

OF_PHOTOGRAPHS = ("above_mat_mm", "mat_bar_mm")
KEYS = tuple(key for key in ValuesDescription.model_fields if key not in OF_PHOTOGRAPHS)
ConvertConfig = make_dataclass("ConvertConfig", [
    *((key, str) for key in ("values", "out", "export", "checkpoint")),
    *((key, object) for key in KEYS)])
"""``configs/convert.yaml``; the values are checked as those of a file."""


@command("convert", ConvertConfig)
def main(config: Any) -> None:
    """Convert the values of a file and of the command line, which replace those of the file."""
    from drapenet.result.terminal import print_estimate

    stated = {key: value for key, value in asdict(config).items()
              if key in KEYS and value is not None}
    print(_convert(_read(config.values, stated), config.out, config.export, config.checkpoint,
                   print_estimate)[1])


def convert(
    values: str | Path | Mapping[str, Any], out: str | Path = "", export: str = "all", *,
    checkpoint: str | Path = "",
) -> "Estimate":
    """Estimate a fabric from values of testers alone, and write it for other tools.

    Args:
        values: a ``values.yaml``, its folder, or its content, such as ``{"density_g_m2": 210,
            "known": {"bending_length_mm": {"warp": 22, "weft": 18}}}``.
        out: folder of estimate, report and files; empty: ``outputs/convert/FABRIC``.
        export: names of ``docs/exports.md`` with commas, ``all``, or empty for none.
        checkpoint: FILE.safetensors of ``train.py``; empty: the bundled one.

    InputError for values that are no fabric's.
    """
    require(values=(values, str | Path | Mapping), out=(out, str | Path), export=(export, str),
            checkpoint=(checkpoint, str | Path))
    measured = _read("", values) if isinstance(values, Mapping) else _read(values, {})
    return _convert(measured, out, export, checkpoint)[0]


def _read(file: str | Path, stated: Mapping[str, Any]) -> ValueSet:
    """What a file, or that in a folder, and ``stated`` values say."""
    if not str(file):
        return ValueSet.of(ValuesDescription.of(stated, ""), Path("values"))
    path = Path(file)
    if path.is_dir():
        path = require_file_in(path, FILE, ValuesDescription.content)
    return ValueSet.of(ValuesDescription.of({**read_yaml(path), **stated}, path), Path(file))


def _convert(
    measured: ValueSet, out: str | Path, export: str, checkpoint: str | Path, shown: Any = None
) -> "tuple[Estimate, str]":
    """The estimate, and the line that names the files."""
    from drapenet.export.formats import export_beside, targets_named
    from drapenet.fabric.entries import plain_name
    from drapenet.fabric.estimate import estimate_fabric
    from drapenet.fabric.sources import Source
    from drapenet.network.checkpoint import read_header
    from drapenet.result.files import ESTIMATE, require_output

    names = targets_named(export, "export") if export else []
    name = plain_name(measured.labels.fabric or measured.path.stem)
    folder = folder_named(str(out or Path("outputs/convert") / name))
    with locked(folder):
        require_output(folder, [measured.path])
        found = estimate_fabric(
            [Source(place=measured, kind=measured.name)], read_header(checkpoint),
            EstimateOptions(), folder=folder,
            on_estimate=shown or (lambda document, folder: None))
        return found.estimate, export_beside(folder / ESTIMATE, names)


if __name__ == "__main__":
    main()
