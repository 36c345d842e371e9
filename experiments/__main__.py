"""Run a benchmark.

    python -m experiments                       # lists them
    python -m experiments NAME [key=value ...]  # NAME --help lists the keys

A benchmark prints tables and writes a report, docs/validation/NAME.json unless out= names another
file; most also write a figure beside it. An interrupted run resumes from its folder cases=."""

import ast
import sys
from dataclasses import asdict
from functools import partial, wraps
from importlib import import_module
from pathlib import Path
from typing import Any

from common.command import command, commands, schema_of
from common.configs import group_options
from common.files import require_file, require_folder

FOLDERS = ("physics", "speed", "estimation")
FILES = {name: file for folder in FOLDERS for name in group_options("benchmark")
         if (file := Path(__file__).parent / folder / f"{name}.py").is_file()}
"""Modules of the benchmarks by name, ordered by folder."""
_EXECUTION_KEYS = ("workers", "cases", "work", "out")


def usage() -> str:
    """Module docstring followed by one line per benchmark."""
    lines = [__doc__]
    for name, file in FILES.items():
        if name == next(one for one in FILES if FILES[one].parent == file.parent):
            lines.append(f"\n{file.parent.name}:")
        about = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
        lines.append(f"  {name:14}{about.partition(chr(10))[0]}")
    return "\n".join(lines)


def run_benchmark(name: str, words: list[str]) -> None:
    """Run the benchmark ``name`` with the overrides ``words``; write its report and figure."""
    module = import_module(f"experiments.{FILES[name].parent.name}.{name}")

    @command(f"benchmark/{name}", schema_of(f"benchmark/{name}"))
    @wraps(module.run)  # the help is the docstring of its module
    def run(settings: Any) -> None:
        from experiments.common import REPORTS, write_figure, write_report

        config = asdict(settings)
        out = Path(config["out"]) if config["out"] else REPORTS / f"{name}.json"
        require_file(out)
        for folder in {"cases", "work"} & set(config):
            require_folder(Path(config[folder]))
        found = module.run(config)
        kept = {key: value for key, value in config.items() if key not in _EXECUTION_KEYS}
        write_report(out, {"settings": kept, **found.report})
        if found.figure:
            write_figure(out.with_suffix(".png"), found.figure)

    run(words)


main = commands({name: partial(run_benchmark, name) for name in FILES}, usage=usage())

if __name__ == "__main__":
    sys.argv[1:] = sys.argv[1:] or ["--help"]
    main()
