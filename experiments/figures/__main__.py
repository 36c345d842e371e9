"""Update the figures of README.md and docs/*.md, see :mod:`experiments.figures`."""

import experiments.figures
from common.command import run_command
from common.errors import InputError
from common.files import replace_file
from experiments.figures.pages import PAGES, fill_blocks
from experiments.result import ROOT


def main(argv: list[str]) -> None:
    """Update all pages; print the names of those that changed."""
    if argv in (["-h"], ["--help"]):
        print(experiments.figures.__doc__)
        return
    if argv:
        raise InputError(f"{' '.join(argv)}: this command takes no settings")
    for page in PAGES:
        old = page.read_text(encoding="utf-8")
        if (new := fill_blocks(old)) != old:
            replace_file(page, new.encode())
            print(page.relative_to(ROOT))


if __name__ == "__main__":
    run_command(main)
