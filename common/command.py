"""Commands as Hydra applications (https://hydra.cc): ``@command("infer", InferConfig)``.

``configs/NAME.yaml`` and its groups hold the defaults with their comments, the schema, a dataclass,
the types and ranges. Texts need no quotes and lists no brackets, except in a sweep.
Groups of one command alone are in ``configs/NAME``: of a group in ``configs``, no command may have
a key of the same name, which Hydra would take for a choice of it.
"""

import errno
import functools
import os
import re
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import is_dataclass, make_dataclass
from functools import partial
from pathlib import Path
from types import GenericAlias
from typing import Any, NoReturn, get_args, get_origin, get_type_hints

from pydantic import ConfigDict, TypeAdapter, ValidationError

from common.configs import CONFIG_DIR, config_text, group_options, read_config
from common.documents import decimal, faults
from common.errors import InputError, one_line


@functools.cache
def _read_decimals() -> None:
    """Let OmegaConf, which has no setting for it, read decimal numbers in files of settings."""
    from omegaconf import _utils

    made = _utils.get_yaml_loader
    _utils.get_yaml_loader = lambda: decimal(made())


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
    """Call ``task`` with the settings that Hydra composes, in a sweep once for each job."""
    if {"-h", "--help"} & set(words):
        print(help_text(name, sys.modules[task.__module__].__doc__ or ""))
        return
    from hydra import compose
    from hydra._internal.utils import get_args_parser  # of what hydra.main takes from sys.argv
    from hydra.types import RunMode

    for word in words:
        key = word.strip("-").partition("=")[0]
        if word.startswith("-") and key in get_type_hints(schema):
            raise InputError(f"{word}: write {key}=VALUE, without dashes")
    given = get_args_parser().parse_intermixed_args(words)
    for option in ("config_path", "experimental_rerun", "shell_completion"):
        if getattr(given, option):
            raise InputError(f"--{option.replace('_', '-')} is not taken; see --help")
    for word in given.overrides:
        if "=" not in word and word[:1] != "~":
            raise InputError(f"{word}: write KEY=VALUE without spaces around =, in quotes if it "
                             "has spaces: 'KEY=MY VALUE'; --help lists the keys")
    config = None
    overrides = (_of_sweep(name, given.overrides) if given.multirun else
                 [quoted(word, schema) for word in given.overrides])
    with _hydra(name, words, given.config_dir) as (hydra, places):
        asked: dict[str, Any] = {"config_name": given.config_name or name,
                                 "overrides": [*places, *overrides]}
        if given.hydra_help:
            hydra.hydra_help(asked["config_name"], get_args_parser(), given)
        elif given.cfg:
            hydra.show_cfg(**asked, cfg_type=given.cfg, package=given.package,
                           resolve=given.resolve)
        elif given.info:
            hydra.show_info(given.info, **asked)
        elif given.multirun or (_may_sweep(given) and hydra.get_mode(**asked) is RunMode.MULTIRUN):
            job = functools.wraps(task)(lambda config: task(checked(config, schema)))
            hydra.multirun(**asked, task_function=job)
        else:
            config = checked(compose(**asked), schema)
    if config is not None:  # outside of Hydra, which has words of its own for errors
        task(config)


def _may_sweep(given: Any) -> bool:
    """Whether these arguments may make a sweep without ``--multirun``: a launcher, Hydra's
    settings, files of the user. To find out, Hydra composes once more, in a quarter of a second."""
    return bool(given.config_dir or given.config_name or any(
        word.lstrip("+").startswith(("launcher", "hydra")) for word in given.overrides))


@contextmanager
def _hydra(name: str, words: Sequence[str], folder: str | None = None
           ) -> Iterator[tuple[Any, list[str]]]:
    """Hydra, with the settings of a ``folder``, of ``configs`` and of groups of one command, and
    the override that states their places; its errors say what to write in place of ``words``."""
    from hydra import initialize_config_dir
    from hydra.core.global_hydra import GlobalHydra

    _read_decimals()
    folders = [Path(folder).absolute()] if folder else []
    folders += filter(Path.is_dir, (CONFIG_DIR, CONFIG_DIR / name))
    if not folders[0].is_dir():
        raise InputError(f"--config-dir {folder}: there is no such folder")
    places = ",".join(f"'file://{place}'" for place in folders[1:])
    try:
        with initialize_config_dir(str(folders[0]), Path(name).name, version_base="1.3"):
            yield GlobalHydra.instance().hydra, [f"hydra.searchpath=[{places}]"] * bool(places)
    except InputError:
        raise
    except Exception as error:
        raise _fault(error, words) from error


def _fault(error: Exception, words: Sequence[str]) -> InputError:
    """An error of Hydra that names what to write in place of ``words``."""
    from hydra.errors import OverrideParseException

    if isinstance(error, OverrideParseException):
        key, _, value = error.override.partition("=")
        return InputError(f"{error.override} cannot be read; put each text in it in quotes, such "
                          f"as \"{key}='{value.strip('[]').split(',')[0]}'\"")
    if unknown := re.match(r"Could not override '([^']+)'", str(error)):
        word = next((word for word in words if word.startswith(unknown[1])), unknown[1])
        return InputError(f"{word}: unknown key; --help lists the keys")
    return InputError(f"{one_line(error)}; see {' '.join(words)}")


def _of_sweep(name: str, words: list[str]) -> list[str]:
    """Overrides of a sweep, whose default of ``out`` is in the folder of each job."""
    content, keys = read_config(name), {word.partition("=")[0] for word in words}
    parts = content.get("hydra", {}).get("sweeper", {}).get("params", {})
    replaced = [f"~hydra.sweeper.params.{key}" for key in parts if key in keys]
    if content.get("out") and not parts and "out" not in keys:
        out = Path(content["out"])
        replaced.append("out=${hydra:runtime.output_dir}" + f"/{out.name}" * bool(out.suffix))
    return [*replaced, *words]


def quoted(word: str, schema: type) -> str:
    """An argument in Hydra's grammar, which takes few characters without quotes: texts, also those
    of a list, in quotes, lists in brackets."""
    key, equals, value = word.partition("=")
    kind: Any = schema
    for part in key.split("."):
        kind = get_type_hints(kind).get(part) if is_dataclass(kind) else None
    if not equals or _is_quoted(value):
        return word
    if get_origin(kind) is list and value[:1] != "[":
        value = f"[{value}]"
    listed = value[:1] == "[" and value[-1:] == "]"
    if kind is str or (kind is Any and not listed):
        return f"{key}={_in_quotes(value)}"
    if listed and (kind is Any or str in get_args(kind)):
        texts = [text for text, _ in _ITEM.findall(value[1:-1]) if text]
        return f"{key}=[{','.join(map(_in_quotes, texts))}]"
    return f"{key}={value}"


_ITEM = re.compile(r"""\s*('(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*"|(?:\$\{[^}]*\}|[^,])*?)\s*(,|$)""")
"""One text of a list, in quotes or without commas, and what ends it."""


def _is_quoted(value: str) -> bool:
    return len(value) > 1 and value[0] in "'\"" and value[-1] == value[0]


def _in_quotes(text: str) -> str:
    """A text in single quotes, unless it has quotes."""
    if _is_quoted(text):
        return text
    return "'" + re.sub(r"(\\+)$", r"\1\1", re.sub(r"(\\*)'", r"\1\1\\'", text)) + "'"


def compose_config(name: str, words: Sequence[str], *, schema: type) -> Any:
    """Compose ``configs/NAME.yaml`` with the overrides ``words`` into an instance of ``schema``."""
    from hydra import compose

    with _hydra(name, words) as (_, places):
        return checked(compose(name, [*places, *(quoted(word, schema) for word in words)]), schema)


def schema_of(name: str) -> type:
    """Derive a schema for ``configs/NAME.yaml`` and included files from their values; those that
    are null, alone or in a list, may be numbers."""
    from hydra import compose
    from omegaconf import OmegaConf

    def kind(value: Any) -> Any:
        if isinstance(value, Mapping):
            return make_dataclass("Settings", [(key, kind(item)) for key, item in value.items()])
        if isinstance(value, list):
            return GenericAlias(list, kind(None if None in value else value[0]))
        return float | None if value is None else type(value)

    with _hydra(name, []) as (_, places):
        return kind(OmegaConf.to_container(compose(name, places)))


def checked(config: Any, schema: type) -> Any:
    """A composed ``config`` as an instance of ``schema``."""
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    # That of nested dataclasses, too.
    schema.__pydantic_config__ = ConfigDict(  # type: ignore[attr-defined]
        extra="forbid", allow_inf_nan=False, coerce_numbers_to_str=True)
    try:
        content = OmegaConf.to_container(config, resolve=True, throw_on_missing=True)
        return TypeAdapter(schema).validate_python(content)
    except OmegaConfBaseException as error:
        raise InputError(one_line(error)) from None
    except ValidationError as error:
        raise InputError(faults(error)) from None


def help_text(name: str, usage: str) -> str:
    """Usage, and the files of ``configs/NAME.yaml``, of those it includes and of its groups."""
    files: list[str] = [name]
    groups: dict[str, str] = {}
    for default in read_config(name)["defaults"]:
        if isinstance(default, Mapping):
            groups |= default
        elif default.strip("/") not in ("_self_", "command"):
            files.append(f"{Path(name).parent / default.partition('@')[0]}")
    parts = [usage.rstrip(), *(f"\nKeys (configs/{file}.yaml):\n\n{_keys(file)}" for file in files)]
    for group, default in groups.items():
        folder = f"{name}/{group}" if group_options(f"{name}/{group}") else group
        for option in group_options(folder):
            mark = ", the default" if option == default else ""
            text = textwrap.indent(_keys(f"{folder}/{option}"), "    ")
            parts.append(f"\n{group}={option}{mark}\n{text}")
    return "\n".join([*parts, _HYDRA])


def _keys(file: str) -> str:
    """A file's keys and comments, without what is addressed to Hydra."""
    return re.sub(r"^(?:# @package.*\n|(?:defaults|hydra):.*\n(?: .*\n|\n)*)", "",
                  config_text(file), flags=re.M).strip()


_HYDRA = """
Texts need no quotes, lists are [A,B]; ${key} is the value of another key. With --multirun, values
separated by commas are jobs (https://hydra.cc). --cfg job prints the settings instead of running,
--info their sources, --config-dir DIR adds configuration files; --hydra-help lists all options."""


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
