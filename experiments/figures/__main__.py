"""Update the figures of README.md and docs/*.md, see :mod:`experiments.figures`."""

import experiments.figures
from common.command import run_command
from common.errors import InputError
from experiments.figures.pages import fill_pages


def main(argv: list[str]) -> None:
    """Update all pages; print the names of those that changed."""
    if argv in (["-h"], ["--help"]):
        print(experiments.figures.__doc__)
    elif argv:
        raise InputError(f"{' '.join(argv)}: this command takes no settings")
    else:
        fill_pages()


if __name__ == "__main__":
    run_command(main)
