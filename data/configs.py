"""Composition of the files in ``configs/`` with the words of a command line.

Hydra composes the configuration only: no folder, log file or change of directory of its own.
"""

import itertools
import re
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from common.errors import InputError, one_line
from common.files import folder_named

if TYPE_CHECKING:
    from omegaconf import DictConfig

CONFIG_DIR = Path(__file__).resolve().parent.parent / "configs"


def compose_config(name: str, words: list[str], *, schema: type | None = None) -> "DictConfig":
    """Compose ``configs/NAME.yaml`` under the overrides ``words`` (Hydra's grammar).

    Args:
        name: primary configuration.
        words: overrides, such as ``drapes=100`` or ``dataset=paper``.
        schema: dataclass that fixes the types of all keys; values are converted to them.

    Raises:
        InputError: an unknown key or group option, a group without an option, a word that is no
            override, a wrong type, a key without a value, an empty ``out``.
    """
    # Imported late: whoever only looks for a file in configs/ need not wait for Hydra.
    from hydra import compose, initialize_config_dir
    from hydra.errors import HydraException
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    for word in words:
        if "=" not in word and not word.startswith("~"):
            raise InputError(f"'{word}' is not of the form key=value; {_known_keys(name)}")
    try:
        with initialize_config_dir(version_base="1.3", config_dir=str(CONFIG_DIR)):
            config = compose(name, overrides=words)
        if schema is not None:
            config = OmegaConf.merge(OmegaConf.structured(schema), config)
        OmegaConf.resolve(config)
    except (HydraException, OmegaConfBaseException) as error:
        raise InputError(_complaint(error, name)) from None
    except (ValueError, TypeError) as error:
        # Hydra's own checks of what a group is set to, as in "dataset=null", name no word.
        raise InputError(f"{one_line(error)}; look at: {' '.join(words)}") from None
    if missing := OmegaConf.missing_keys(config):
        raise InputError(f"keys without a value: {', '.join(sorted(missing))}")
    if config.get("out") is not None:
        folder_named(config["out"])
    return config


def _complaint(error: Exception, name: str) -> str:
    """What Hydra or OmegaConf has against the words for ``configs/NAME.yaml``, in one line."""
    first, key = str(error).partition("\n")[0], getattr(error, "full_key", None)
    if unknown := re.match(r"Could not override '(.+)'|Key '.+' not in ", first):
        key = unknown[1] or key
        group = key.partition(".")[0]
        if group != key and (CONFIG_DIR / group).is_dir():
            return f"unknown key '{key}'; those of {group} are in the files of {CONFIG_DIR / group}"
        return f"unknown key '{key}'; {_known_keys(name)}"
    return f"{key}: {first}" if key else _first_lines(str(error))


def _known_keys(name: str) -> str:
    """For complaints: keys and groups of ``configs/NAME.yaml``."""
    content = read_config(name)
    defaults = [default for default in content.pop("defaults") if isinstance(default, dict)]
    groups = {group for default in defaults for group in default if "override " not in group}
    return f"known keys: {', '.join(sorted(groups | content.keys() - {'hydra'}))}"


def _first_lines(message: str) -> str:
    """Hydra's complaint in one line, without its search path and links."""
    kept = []
    for line in message.splitlines():
        if line.startswith(("Config search path", "See https")):
            break
        kept.append(line.strip())
    text = " ".join(filter(None, kept))
    unquoted = text.removeprefix("LexerNoViableAltException: ").removesuffix(" ^")
    if unquoted == text:
        return text
    return f"cannot read {unquoted}; put unusual characters in two pairs of quotes: 'key=\"value\"'"


def group_options(group: str) -> list[str]:
    """Names of the alternatives in ``configs/GROUP``."""
    return sorted(path.stem for path in (CONFIG_DIR / group).glob("*.yaml"))


def describe_config(name: str, groups: list[str]) -> str:
    """For ``--help``: the keys of ``configs/NAME.yaml`` and of its groups, with their comments.

    Of a group's alternatives to the default option only what their files say of themselves.
    """
    lines = (CONFIG_DIR / f"{name}.yaml").read_text(encoding="utf-8").splitlines()
    parts = ["\n".join(line for line in lines if _is_key(line))]
    chosen = {}
    for default in read_config(name)["defaults"]:
        chosen |= default if isinstance(default, dict) else {}
    for group in groups:
        for option in sorted(group_options(group), key=lambda o: (o != chosen[group], o)):
            text = (CONFIG_DIR / group / f"{option}.yaml").read_text(encoding="utf-8")
            about = [line[1:].strip() for line in text.splitlines() if line.startswith("#")
                     and "@package" not in line]
            about = list(itertools.takewhile(bool, about))  # the first paragraph
            is_default = option == chosen[group]
            parts.append(f"\n{group}={option}" + (", the default" if is_default else ""))
            parts += textwrap.wrap(" ".join(about), 96, initial_indent="    ",
                                   subsequent_indent="    ")
            if is_default:
                parts += [f"  {group}." + line if line[0] != " " else "    " + line
                          for line in text.splitlines() if line and line[0] not in "#"]
    return "\n".join(parts)


def _is_key(line: str) -> bool:
    """Whether a line of a primary configuration sets a key of the user's."""
    return bool(line) and line[0] not in " #" and not line.startswith(("defaults:", "hydra:"))


def read_config(name: str) -> dict:
    """The content of ``configs/NAME.yaml`` as it stands, without Hydra."""
    return yaml.safe_load((CONFIG_DIR / f"{name}.yaml").read_text(encoding="utf-8"))


def read_option(group: str, name: str) -> dict:
    """The content of ``configs/GROUP/NAME.yaml``; InputError when there is no such file."""
    known = group_options(group)
    if name not in known:
        raise InputError(f"unknown {group} {name!r}; known {group}s: {', '.join(known)}")
    return read_config(f"{group}/{name}")
