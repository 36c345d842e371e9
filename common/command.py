"""Commands with settings: ``@command("infer", InferConfig)``.

``configs/NAME.yaml`` and its groups hold the defaults with their comments, the schema, a dataclass,
the types and ranges. Words of the command line: :mod:`common.words`; sweeps: :mod:`common.sweeps`.
"""

import argparse
import errno
import functools
import os
import re
import sys
import textwrap
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NoReturn, get_type_hints

from common.configs import config_text, folder_of, group_options, read_config
from common.documents import yaml_text
from common.errors import InputError
from common.words import checked, stated


def command(
    name: str, schema: type
) -> Callable[[Callable[[Any], None]], Callable[..., None]]:
    """Decorator: make a function of a ``schema`` object the command of ``configs/NAME.yaml``; its
    help begins with its module's docstring.
    """
    return lambda task: functools.wraps(task)(_main(partial(_run, task, name, schema)))


def commands(
    named: Mapping[str, Callable[[list[str]], None]], *, usage: str
) -> Callable[..., None]:
    """A command whose first argument chooses among those ``named``; --help prints ``usage``."""

    def choose(words: list[str]) -> None:
        name, *arguments = words or [""]
        if name in ("-h", "--help"):
            print(usage)
        elif name in named:
            named[name](arguments)
        else:
            raise InputError(f"the first word must be one of: {', '.join(named)}")

    return _main(choose)


def _main(run: Callable[[list[str]], None]) -> Callable[..., None]:
    """A command that reads ``sys.argv`` and ends the process; called with a list of arguments, it
    returns or raises InputError.
    """
    def main(words: Sequence[str] | None = None) -> None:
        run_command(run) if words is None else run(list(words))

    return main


def _run(task: Callable[[Any], None], name: str, schema: type, words: list[str]) -> None:
    """Call ``task`` with the settings, in a sweep once for each job."""
    if {"-h", "--help"} & set(words):
        print(help_text(name, sys.modules[task.__module__].__doc__ or ""))
        return
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--config-dir", "-cd", type=Path)
    parser.add_argument("--config-name", "-cn", default=name)
    parser.add_argument("--cfg", "-c")
    given, settings = parser.parse_known_args(words)
    for word in settings:
        key = word.strip("-").partition("=")[0]
        if word.startswith("-") and key in get_type_hints(schema):
            raise InputError(f"{word}: write {key}=VALUE, without dashes")
    if given.cfg not in (None, "job") or any(
            word.startswith(("-", "+", "~", "hydra", "launcher=")) for word in settings):
        from common.sweeps import run_by_hydra

        run_by_hydra(task, name, schema, words)
        return
    if given.config_dir and not given.config_dir.is_dir():
        raise InputError(f"--config-dir {given.config_dir}: there is no such folder")
    content = stated(given.config_name, settings, schema, given.config_dir)
    if given.cfg:
        print(yaml_text(content), end="")
    else:
        task(checked(content, schema))


def compose_config(name: str, words: Sequence[str], *, schema: type) -> Any:
    """The settings of ``configs/NAME.yaml``, with those that ``words`` state, as a ``schema``."""
    return checked(stated(name, words, schema), schema)


def help_text(name: str, usage: str) -> str:
    """Usage, and the files of ``configs/NAME.yaml`` and of its groups."""
    parts = [usage.rstrip(), f"\nKeys (configs/{name}.yaml):\n\n{_keys(name)}"]
    groups = [entry for entry in read_config(name).get("defaults", ()) if entry != "_self_"]
    for group, default in [item for entry in groups for item in entry.items()]:
        folder = folder_of(group, name)
        for option in group_options(folder):
            mark = ", the default" if option == default else ""
            text = textwrap.indent(_keys(f"{folder}/{option}"), "    ")
            parts.append(f"\n{group}={option}{mark}\n{text}")
    return "\n".join([*parts, _WORDS])


def _keys(file: str) -> str:
    """A file's keys and comments, without what is addressed to Hydra."""
    return re.sub(r"^(?:# @package.*\n|(?:defaults|hydra):.*\n(?: .*\n|\n)*)", "",
                  config_text(file), flags=re.M).strip()


_WORDS = """
Texts need no quotes, lists are [A,B]; ${key} is the value of another key. --cfg job prints the
settings instead of running, --config-dir DIR adds configuration files. With --multirun, values
separated by commas are jobs of Hydra (https://hydra.cc); --hydra-help lists its options."""


def run_command(main: Callable[[list[str]], object]) -> NoReturn:
    """Run ``main(sys.argv[1:])`` and exit; an InputError is printed as one line, exit code 2."""
    import common.interrupt  # noqa: F401 (for commands that do not import it first)

    open_output()
    try:
        main(sys.argv[1:])
        sys.stdout.flush()
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except OSError as error:
        if error.errno not in (errno.EPIPE, errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            raise
        # Discard what standard output still holds, so that Python's final flush does not fail.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if error.errno != errno.EPIPE:  # of a reader, such as `head`, that has closed the pipe
            with suppress(OSError):
                print(f"error: {error.strerror}; make room, or send the output elsewhere",
                      file=sys.stderr)
            sys.exit(2)
    sys.exit(0)


def open_output() -> None:
    """Replace closed standard streams, and escape characters that they cannot encode."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))
        elif hasattr(getattr(sys, name), "reconfigure"):
            getattr(sys, name).reconfigure(errors="backslashreplace")
