"""Export of an estimate to files of other tools.

    python -m drapenet.export estimate=ESTIMATE.json to=NAME [out=FILE or FOLDER] [name=FABRIC]
    python -m drapenet.export estimate=ESTIMATE.json to=NAME [mesh=KIND edge_mm=N]
    python -m drapenet.export estimate=ESTIMATE.json to=all [out=FOLDER]
    python -m drapenet.export to=list
"""

from pathlib import Path

from common.command import command
from common.errors import InputError
from common.files import require_file, require_folder
from drapenet.config import ExportConfig
from drapenet.export.cards import PROGRAMS, card_lines, cards
from drapenet.export.formats import (
    TARGETS,
    export,
    export_all,
    names_in,
    table,
    targets_named,
)
from drapenet.export.material import read_material


@command("export", ExportConfig)
def main(config: ExportConfig) -> None:
    """Write the files, and print their names."""
    if config.to == "list":
        print(table())
        return
    if not config.estimate:
        raise InputError("estimate= is missing; give an estimate.json: estimate=FILE")
    if not config.to:
        raise InputError(f"to= is missing; give one of {', '.join(TARGETS)} or all")
    names, path = targets_named(config.to), Path(config.estimate)
    refusals: list[str] = []
    material = read_material(path, curvature_1_m=config.curvature_1_m, mesh=config.mesh,
                             edge_mm=config.edge_mm, name=config.name)
    out = Path(config.out or (path if path.is_dir() else path.parent))
    if len(names) == 1 and out.suffix and not out.is_dir():
        if out.suffix.lower() != (usual := Path(TARGETS[names[0]].file).suffix):
            raise InputError(f"out={out}: the file for to={names[0]} ends in {usual}; give such a "
                             "name, or a folder")
        require_file(out)
        written = export(material, names[0], out)
    else:
        require_folder(out)
        written, refusals = export_all(material, names, out)
    if not written:
        raise InputError(refusals[0])
    print("\n".join([*map(str, written), *(f"left out: {refusal}" for refusal in refusals)]))
    tools = {PROGRAMS.get(name) for name in names_in(config.to)}
    for card in cards(material):
        if card["tool"] in tools:
            print("\n".join(card_lines(card)))
    for warning in material.about["warnings"]:
        print(f"warning: {warning}")


if __name__ == "__main__":
    main()
