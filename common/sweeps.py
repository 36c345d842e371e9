"""Sweeps of commands and other options of Hydra (https://hydra.cc), with its grammar of words."""

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import hydra
from hydra.errors import HydraException, OverrideParseException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from common.configs import CONFIG_DIR, read_config
from common.errors import InputError, one_line
from common.words import checked

SETTINGS = ("hydra/job_logging=none", "hydra.output_subdir=null", "hydra.run.dir=.",
            "hydra.sweep.dir=outputs/sweeps/${now:%Y-%m-%d_%H-%M-%S}")
"""Of every command: no log file, and no folder but one for each job of a sweep."""


def run_by_hydra(
    task: Callable[[Any], None], name: str, schema: type, words: list[str]
) -> None:
    """Call ``task`` with each of the settings that Hydra composes of ``words``, or do what they ask
    of Hydra."""
    def job(config: Any) -> None:
        task(checked(OmegaConf.to_container(config, resolve=True), schema))

    stated = [word for word in words if word[:1] == "~" or ("=" in word and word[:1] != "-")]
    options = [word for word in words if word not in stated]
    for option in options:
        if option in ("-sc", "--shell-completion", "--experimental-rerun"):
            raise InputError(f"{option} is not taken; see --help")
    argv, sys.argv = sys.argv, [name, *options, "--", *SETTINGS, *_places(name, stated), *stated]
    os.environ["HYDRA_FULL_ERROR"] = "1"  # raise errors
    try:
        hydra.main(str(CONFIG_DIR), name, version_base="1.3")(job)()
    except OverrideParseException as error:
        key, _, value = error.override.partition("=")
        raise InputError(f"{error.override} cannot be read; put each text in it in quotes, such "
                         f"as \"{key}='{value.strip('[]').split(',')[0]}'\"") from None
    except (HydraException, OmegaConfBaseException) as error:
        raise InputError(f"{one_line(error)}; see {' '.join(words)}") from None
    finally:
        sys.argv = argv


def _places(name: str, words: list[str]) -> list[str]:
    """Words that state where the groups of one command are, and give each job an ``out`` in its
    folder, unless ``words`` state it or jobs share it."""
    content, keys = read_config(name), {word.partition("=")[0] for word in words}
    shared = content.get("hydra", {}).get("sweeper", {}).get("params", {})
    places = [f"~hydra.sweeper.params.{key}" for key in shared if key in keys]
    if (CONFIG_DIR / name).is_dir():
        places.append(f"hydra.searchpath=['file://{CONFIG_DIR / name}']")
    if content.get("out") and not shared and "out" not in keys:
        out = Path(content["out"])
        places.append("out=${hydra:runtime.output_dir}" + f"/{out.name}" * bool(out.suffix))
    return places
