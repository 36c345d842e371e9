"""Commands as Hydra applications: ``@command("infer", InferConfig)`` above a function.

``configs/NAME.yaml`` and its groups hold the defaults with their comments, the schema the types and
ranges. Extends Hydra's command line, with its options, groups, sweeps and launchers:

- an input error is one line on standard error and exit code 2 (:func:`common.cli.run_command`);
- text values need no quotes, whatever a path contains; only ``${key}`` is replaced by the value of
  a key. In a sweep (``--multirun``) values follow Hydra's grammar, where commas separate jobs;
- a list of numbers needs no brackets;
- each job of a sweep has a unique ``out``: by default its folder of the sweep;
- the first argument may be the value of a key, or choose among several commands
  (:func:`commands`).
"""

import difflib
import functools
import itertools
import math
import os
import re
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, fields, is_dataclass, make_dataclass
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from common.cli import FULL_ERROR, check_counts, refuse_repeated, run_command
from common.configs import CONFIG_DIR, config_text, group_options, read_config
from common.errors import InputError, one_line

_QUOTES = ("'", '"')
_GLOBAL = "# @package _global_\n"


def command(
    name: str, schema: type, *, check: Callable[[Any], object] | None = None, first: str = "",
    swept_out: str | None = None,
) -> Callable[[Callable[[Any], None]], Callable[..., None]]:
    """Decorator: make a function of a ``schema`` object the command of ``configs/NAME.yaml``.

    The command reads ``sys.argv`` and ends the process; called with a list of arguments, as in
    tests, it returns or raises InputError. Its help begins with its module's docstring.

    Args:
        check: raises InputError for invalid settings before the jobs of a sweep start.
        first: key whose value is the first argument, unless that sets a key.
        swept_out: default of ``out`` in a sweep, relative to the job's folder. None: the file name
            of the default ``out``, or the job's folder if it is a folder; unset if it is empty.
    """

    def decorate(task: Callable[[Any], None]) -> Callable[..., None]:
        def main(words: Sequence[str] | None = None) -> None:
            run = functools.partial(_run, task, name, schema, check, first, swept_out)
            run_command(run) if words is None else run(list(words))

        return functools.wraps(task)(main)

    return decorate


def commands(
    named: Mapping[str, Callable[[list[str]], None]], *, usage: str
) -> Callable[..., None]:
    """A command whose first argument chooses among those ``named``; --help prints ``usage``."""

    def choose(words: list[str]) -> None:
        name, *others = words or [""]
        if name in ("-h", "--help"):
            print(usage)
        elif name in named:
            named[name](others)
        else:
            fault = f"unknown command '{name}'{_suggestion(name, named)}" if name else "no command"
            raise InputError(f"{fault}; the first word is one of: {', '.join(named)}")

    def main(words: Sequence[str] | None = None) -> None:
        run_command(choose) if words is None else choose(list(words))

    return main


def _run(
    task: Callable[[Any], None], name: str, schema: type, check: Callable[[Any], object] | None,
    first: str, swept_out: str | None, words: list[str],
) -> None:
    from hydra import main
    from hydra.core.hydra_config import HydraConfig
    from hydra.types import RunMode
    from omegaconf import OmegaConf

    store_schema(name, schema)
    OmegaConf.register_new_resolver(
        "help", lambda: describe(name, sys.modules[task.__module__].__doc__), replace=True)
    words, overrides, sweep = _hydra_words(name, schema, first, words)
    failed: list[Exception] = []
    inside: str | None = None  # out= of a job of a sweep, relative to its folder

    @functools.wraps(task)  # Hydra reads the task's module
    def job(config: Any) -> None:
        swept, folder = HydraConfig.get().mode is RunMode.MULTIRUN, _job_folder()
        try:
            with input_errors(name, schema, overrides):
                if inside is not None:
                    config.out = str(folder / inside)
                settings = as_schema(config, schema)
            task(settings)
        except Exception as error:
            if swept:
                raise
            failed.append(error)  # raised below: Hydra would print a message
        finally:
            if swept:
                with suppress(OSError):  # it is not empty
                    folder.rmdir()

    argv, full = sys.argv, os.environ.get(FULL_ERROR, "0")
    with input_errors(name, schema, overrides, sweep=sweep):
        if sweep:
            inside = _swept_out(name, overrides, swept_out)
        if sweep and check:
            check(as_schema(_compose(name, _job_overrides(overrides)), schema))
        try:  # Hydra reads sys.argv, and raises errors if FULL_ERROR is set
            sys.argv, os.environ[FULL_ERROR] = [argv[0], *words], "1"
            main(version_base="1.3", config_path=str(CONFIG_DIR), config_name=name)(job)()
        finally:
            sys.argv, os.environ[FULL_ERROR] = argv, full
    if failed:
        raise failed[0]


def _hydra_words(
    name: str, schema: type, first: str, words: list[str]
) -> tuple[list[str], list[str], bool]:
    """Arguments for Hydra, the overrides among them, and whether they request a sweep.

    Raises:
        InputError: an unknown option, an argument that is not an override, a key twice.
    """
    from hydra._internal.utils import get_args_parser  # as hydra.main does

    def refuse(message: str) -> None:
        raise InputError(f"{message}; --hydra-help lists the options, and keys are written without "
                         f"dashes, as key=value; {known_keys(name, schema)}")

    parser = get_args_parser()
    parser.error = refuse
    keys = keys_of(name, schema)
    if first and words and words[0][:1] not in "-+~" and (
            _outermost_key(words[0]) not in {*keys, "hydra"}):
        words = [f"{first}={words[0]}", *words[1:]]  # folder names of sweeps contain =
    options = parser.parse_intermixed_args(words)
    for word in options.overrides:
        if "=" not in word and not word.startswith("~"):
            raise InputError(f"'{word}' is not of the form key=value; {known_keys(name, schema)}")
    refuse_repeated(options.overrides)
    params = read_config(name).get("hydra", {}).get("sweeper", {}).get("params", {})
    overrides = []
    for word in options.overrides:
        overrides.append(word if options.multirun else to_hydra(word, schema))
        if (key := word.partition("=")[0]) in params:  # replaces the sweep of the config file
            overrides.append(f"~hydra.sweeper.params.{key}")
    sweep = options.multirun or any("launcher=" in word for word in overrides)
    others = [word for word in words if word not in options.overrides]
    return [*overrides, *others], overrides, sweep  # the only order that Hydra accepts


def _job_overrides(overrides: list[str]) -> list[str]:
    """Overrides of the job that set a key to a single value; ``out`` may depend on the job."""
    return [word for word, override in zip(overrides, _parsed(overrides), strict=True)
            if not word.lstrip("+~").startswith(("hydra", "out=")) and
            not override.is_sweep_override()]


def _parsed(overrides: list[str]) -> list[Any]:
    from hydra.core.override_parser.overrides_parser import OverridesParser

    return OverridesParser.create().parse_overrides(overrides)


def _swept_out(name: str, overrides: list[str], swept_out: str | None) -> str | None:
    """``out`` of a sweep's jobs, relative to each job's folder; None if ``out`` is given, if the
    command has none, or if the jobs are the parts of one result, as listed in the config file.

    Raises:
        InputError: several jobs share an ``out``.
    """
    content = read_config(name)
    divided = content.get("hydra", {}).get("sweeper", {}).get("params", {}).keys()
    parsed = _parsed(overrides)
    swept = {one.key_or_group for one in parsed if one.is_sweep_override()}
    if "out" not in content or (divided and swept <= divided):
        return None
    given = [one for one in parsed if one.key_or_group == "out"]
    if not given:
        default = Path(content["out"])
        named = default.name if default.suffix else "."
        return swept_out or (named if content["out"] else None)
    value = given[0].input_line.partition("=")[2].strip("".join(_QUOTES))
    for key in sorted(swept - {"out"} if value and "${hydra:" not in value else ()):
        if not re.search(rf"\${{{re.escape(key)}[.}}]", value):
            own = f"${{{key}}}" if _is_scalar(content, key) else "${hydra:job.num}"
            raise InputError(f"out={value} is the same for all values of {key}: each job would "
                             f"overwrite the one before; give 'out={value}/{own}', or no out=, so "
                             "that each job has a folder in outputs/sweeps")
    return None


def _is_scalar(content: Any, key: str) -> bool:
    for part in key.split("."):
        content = content.get(part) if isinstance(content, dict) else None
    return isinstance(content, str | int | float)


def _job_folder() -> Path:
    """Output folder of the current job of a sweep."""
    from hydra.core.hydra_config import HydraConfig

    folder = Path(HydraConfig.get().runtime.output_dir)
    return folder.relative_to(Path.cwd()) if Path.cwd() in folder.parents else folder


def to_hydra(word: str, schema: type) -> str:
    """Convert an argument to Hydra's grammar: texts in quotes, lists of numbers in brackets.

    The type Any is one text, or a list of texts in brackets. Quoted values are unchanged.
    """
    key, equals, value = word.partition("=")
    kind = _kind(schema, key)
    if not equals or (len(value) > 1 and value[0] in _QUOTES and value[-1] == value[0]):
        return word
    if kind is Any and value.startswith("[") and value.endswith("]"):
        if any(quote in value for quote in _QUOTES):
            return word
        return f"{key}=[{','.join(_quoted(part.strip()) for part in value[1:-1].split(','))}]"
    if kind in (str, Any):
        return f"{key}={_quoted(value)}"
    if get_origin(kind) is list and get_args(kind) != (str,) and not value.startswith("["):
        return f"{key}=[{value}]"
    return word


def _kind(schema: type, key: str) -> Any:
    """Type of a (dotted) key of ``schema``; None for unknown keys."""
    kind: Any = schema
    for name in key.split("."):
        kind = get_type_hints(kind).get(name) if is_dataclass(kind) else None
    return kind


def _outermost_key(word: str) -> str | None:
    """First part of the dotted key that an override sets; None without =."""
    return word.partition("=")[0].partition(".")[0] if "=" in word else None


def _quoted(text: str) -> str:
    """Quote ``text`` for Hydra, with backslashes before quotes escaped."""
    return "'" + re.sub(r"(\\+)$", r"\1\1", re.sub(r"(\\*)'", r"\1\1\\'", text)) + "'"


# --- Composition ----------------------------------------------------------------------------


def store_schema(name: str, schema: type) -> None:
    """Register ``schema`` for ``configs/NAME.yaml`` under the name ``NAME_schema``."""
    from hydra.core.config_store import ConfigStore

    ConfigStore.instance().store(name=f"{name}_schema", node=schema)


def schema_of(name: str) -> type:
    """Derive a schema for ``configs/NAME.yaml`` and included files from their values."""
    from omegaconf import OmegaConf

    def kind(value: Any) -> Any:
        if isinstance(value, dict):
            return make_dataclass("Settings", [(key, kind(one)) for key, one in value.items()])
        return list[type(value[0])] if isinstance(value, list) else type(value)

    return kind(OmegaConf.to_container(_compose(name, [])))


def compose_config(name: str, words: list[str], *, schema: type) -> Any:
    """Compose ``configs/NAME.yaml`` with the overrides ``words`` into an instance of ``schema``.

    Raises:
        InputError: as on the command line.
    """
    store_schema(name, schema)
    with input_errors(name, schema, words):
        return as_schema(_compose(name, [to_hydra(word, schema) for word in words]), schema)


def _compose(name: str, words: list[str]) -> Any:
    from hydra import compose, initialize_config_dir
    from hydra.core.global_hydra import GlobalHydra

    state = GlobalHydra.instance()
    state.hydra, running = None, state.hydra  # of the running command
    try:
        with initialize_config_dir(version_base="1.3", config_dir=str(CONFIG_DIR)):
            return compose(name, overrides=words)
    finally:
        GlobalHydra.instance().hydra = running


def as_schema(config: Any, schema: type) -> Any:
    """Convert a composed ``config`` to ``schema``; InputError for missing or invalid values."""
    from omegaconf import OmegaConf

    content = OmegaConf.to_container(config, resolve=True)  # refuses keys added by +
    typed = OmegaConf.merge(OmegaConf.structured(schema), content)
    if missing := OmegaConf.missing_keys(typed):
        raise InputError(f"a value is missing for {', '.join(sorted(missing))}; give it as "
                         "key=value")
    settings = OmegaConf.to_object(typed)
    check_counts(vars(settings))
    _require_finite(asdict(settings))
    _require_ranges(settings)
    return settings


def _require_ranges(settings: Any, inside: str = "") -> None:
    """InputError for a value outside the range of its type, such as Annotated[int, Field(ge=1)]."""
    from pydantic import create_model

    from common.documents import Schema

    for key, kind in get_type_hints(type(settings), include_extras=True).items():
        value, name = getattr(settings, key), f"{inside}{key}"
        if is_dataclass(value):
            _require_ranges(value, f"{name}.")
        elif get_origin(kind) is Annotated:
            create_model("Range", __base__=Schema, **{name: (kind, ...)}).of({name: value}, "")


def _require_finite(content: dict[str, Any], inside: str = "") -> None:
    for key, value in content.items():
        if isinstance(value, dict):
            _require_finite(value, f"{inside}{key}.")
        for number in value if isinstance(value, list) else [value]:
            if isinstance(number, float) and not math.isfinite(number):
                raise InputError(f"{inside}{key}={number} must be a finite number, such as 3")


# --- Error messages -------------------------------------------------------------------------


@contextmanager
def input_errors(
    name: str, schema: type, words: list[str], *, sweep: bool = False
) -> Iterator[None]:
    """Convert Hydra's errors about the arguments ``words`` to InputError."""
    from hydra.errors import HydraException
    from omegaconf.errors import OmegaConfBaseException

    try:
        yield
    except InputError:
        raise
    except (HydraException, OmegaConfBaseException) as error:
        raise InputError(_message(error, name, schema)) from error
    except Exception as error:
        if sweep:  # error classes depend on the launcher
            raise InputError(f"a job could not be started, or ended early ({one_line(error)}); "
                             "complete files are kept: run the same command again") from error
        if not isinstance(error, ValueError | TypeError):
            raise
        # Hydra's checks of a group's value, as in "dataset=null", do not name the argument.
        raise InputError(f"{one_line(error)}; see {' '.join(words)}") from error


_EXPECTED = {"Integer": "a whole number, such as 3", "Float": "a finite number, such as 3",
           "bool": "true or false"}
_CONVERSION = re.compile(  # OmegaConf's message
    r"Value '(.*)' (?:of type '.*' could not be converted to|is not a valid) (\w+)")


def _message(error: Exception, name: str, schema: type) -> str:
    if str(error).startswith("Error merging override ") and error.__cause__:
        error = error.__cause__  # states the reason
    first, key = str(error).partition("\n")[0], getattr(error, "full_key", None)
    if unknown := re.match(r"Could not override '(.+)'|Key '.+' not in ", first):
        key = unknown[1] or key
        group, _, inner = key.rpartition(".")
        options = {f"{group}={option}": read_config(f"{group}/{option}")
                   for option in group_options(group)} if group else {}
        if fitting := [word for word, content in options.items() if inner in content]:
            return f"{key} goes with {' or '.join(fitting)}"
        inside = _names(_kind(schema, group)) if group else set()
        if inside := inside.union(*options.values()) - {"defaults"}:
            return (f"unknown key '{key}'{_suggestion(inner, inside)}; keys of {group}: "
                    f"{', '.join(sorted(inside))}")
        return _unknown_key(key, name, schema)
    if (wrong := _CONVERSION.match(first)) and wrong[2] in _EXPECTED:
        return f"{key}={wrong[1]} must be {_EXPECTED[wrong[2]]}"
    if key:
        return f"{key}: {first}"
    if word := getattr(error, "override", None):
        return f"cannot read {word}; put unusual characters in two pairs of quotes: 'key=\"value\"'"
    kept = itertools.takewhile(
        lambda line: not line.startswith(("Config search path", "See https")),
        str(error).splitlines())
    text = " ".join(filter(None, map(str.strip, kept)))
    if option := re.search(r"Could not find '([^'/]+)/([^'/]+)'", text):
        known = ", ".join(group_options(option[1]))
        return f"{option[1]}={option[2]} is unknown; choose from {known}"
    if text.startswith("Ambiguous value"):
        key = _outermost_key(re.sub(r"^.*?'[+~]*", "", first))
        if key and key not in keys_of(name, schema):
            return _unknown_key(key, name, schema)
        return f"{first.removesuffix(':')}: it takes one value; --multirun runs a job for each"
    if "hydra/launcher" in text:
        return f"{text}; install it with pip install 'drapenet[cluster]'"
    return text


def _unknown_key(key: str, name: str, schema: type) -> str:
    known = keys_of(name, schema)
    return f"unknown key '{key}'{_suggestion(key, known)}; {known_keys(name, schema)}"


def _suggestion(key: str, known: Iterable[str]) -> str:
    near = difflib.get_close_matches(key, known, n=1)
    return f", perhaps {near[0]}" if near else ""


def known_keys(name: str, schema: type) -> str:
    """Keys and groups of ``configs/NAME.yaml``, for error messages."""
    return f"known keys: {', '.join(sorted(keys_of(name, schema)))}"


def keys_of(name: str, schema: type) -> set[str]:
    """Keys and groups of ``configs/NAME.yaml``."""
    return _names(schema) | groups_of(name).keys()


def _names(schema: Any) -> set[str]:
    return {field.name for field in fields(schema)} if is_dataclass(schema) else set()


def groups_of(name: str) -> dict[str, str | None]:
    """Groups of ``configs/NAME.yaml``, each with its default option."""
    return {group: option for default in read_config(name)["defaults"] if isinstance(default, dict)
            for group, option in default.items() if "override " not in group}


def included(name: str) -> dict[str, str]:
    """Files that ``configs/NAME.yaml`` includes from its folder, and the key of each."""
    parts = [default.partition("@") for default in read_config(name)["defaults"]
             if isinstance(default, str)]
    files = {(Path(name).parent / file).as_posix(): key for file, _, key in parts}
    return {file: key for file, key in files.items()
            if file != "command" and (CONFIG_DIR / f"{file}.yaml").is_file()}


# --- Help -----------------------------------------------------------------------------------


def describe(name: str, usage: str) -> str:
    """Template of ``--help``: usage, keys of ``configs/NAME.yaml`` and of its groups.

    Other options than a group's default are listed with the comment at the head of their files,
    and with their keys if these differ from the default's.
    """
    parts = [usage.rstrip()]
    for file, under in {name: "", **included(name)}.items():
        keys = re.sub(r"^(defaults|hydra):.*\n(?: .*\n|\n)*", "", config_text(file), flags=re.M)
        where = f" under {under}" if under else ""
        parts += [f"\nKeys{where} (configs/{file}.yaml):\n", keys.replace(_GLOBAL, "").strip()]
    for group, default in groups_of(name).items():
        parts.append(f"\nGroup {group} (configs/{group}):")
        usual = read_config(f"{group}/{default}").keys() if default else None
        for option in sorted(group_options(group), key=lambda one: (one != default, one)):
            text = config_text(f"{group}/{option}").replace(_GLOBAL, "")
            about = "".join(itertools.takewhile(lambda line: line[0] == "#",
                                                text.splitlines(keepends=True)))
            others = usual is not None and not read_config(f"{group}/{option}").keys() <= usual
            shown = text if option == default or others else about
            mark = ", the default" if option == default else ""
            parts.append(f"\n{group}={option}{mark}\n{textwrap.indent(shown, '    ')}".rstrip())
    return "\n".join([*parts, _HYDRA]).replace("$", "$$")


_HYDRA = """
Texts need no quotes, lists are [A,B]; ${key} is the value of another key. With --multirun, values
separated by commas are jobs (https://hydra.cc). --cfg job prints the settings instead of running,
--info their sources, --config-dir DIR adds configuration files; --hydra-help lists all options."""
