"""A dataset in many jobs: ``python -m data.generate --multirun launcher=slurm parts=40 ...``.

Hydra starts the jobs, by Slurm or on this machine; each makes one part of the shards, and the last
one to end finishes the dataset (``docs/cluster.md``).
"""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from common.errors import InputError, one_line
from data.configs import CONFIG_DIR, compose_config
from data.options import Options, config_from_options

MULTIRUN = frozenset({"-m", "--multirun"})
"""The words that ask for many jobs, as everywhere in Hydra."""


def launch(words: list[str], run: Callable[[Options], None]) -> None:
    """Run the jobs that the overrides ``words`` ask for, each by ``run``, and wait for them.

    Without a list of parts, it is one job for each of ``parts``. Any other key can be given
    several values too, as in ``seed=0,1 'out=outputs/set_${seed}'``.

    Raises:
        InputError: a setting makes no sense, before any job is started; a job was ended or failed.
    """
    from hydra import main
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from omegaconf import OmegaConf

    def job(config: object) -> None:
        options = OmegaConf.merge(OmegaConf.structured(Options), config)
        OmegaConf.resolve(options)
        run(options)

    # All but the lists are checked here, where the user sees it.
    parsed = [(word, _parse(OverridesParser.create(), word)) for word in words]
    single = [word for word, override in parsed if not override.is_sweep_override()]
    plain = [word for word in single if not word.startswith("hydra")]
    try:
        options = compose_config("generate", plain, schema=Options)
    except InputError as error:
        if "hydra/launcher" not in str(error):
            raise
        raise InputError(f"{error}; install it with pip install '.[cluster]'") from None
    config_from_options(options)
    for word, override in parsed:
        if override.key_or_group == "parts" and override.is_sweep_override():
            raise InputError(f"{word}: give one number of parts; each part is a job")
    if options.parts < 1:
        raise InputError(f"parts={options.parts} must be at least 1")
    if all(override.key_or_group != "part" for _, override in parsed):
        words = [*words, f"part=range({options.parts})"]
    program = main(version_base="1.3", config_path=str(CONFIG_DIR), config_name="generate")(job)
    try:
        with _as_command_line(["--multirun", *words]):
            program()
    except InputError:
        raise
    except Exception as error:  # whatever Hydra's and the launcher's classes are
        raise InputError(f"a job could not be started or ended early ({one_line(error)}); what is "
                         "whole stays, run the same command again") from None


def _parse(parser: object, word: str) -> object:
    from hydra.errors import HydraException

    try:
        return parser.parse_override(word)
    except HydraException as error:
        raise InputError(f"cannot read {word}: {one_line(error)}") from None


@contextmanager
def _as_command_line(words: list[str]) -> Iterator[None]:
    """Let Hydra, which reads the command line itself, see ``words``, and raise its errors."""
    argv, full = sys.argv, os.environ.get("HYDRA_FULL_ERROR")
    sys.argv = [argv[0], *words]
    os.environ["HYDRA_FULL_ERROR"] = "1"
    try:
        yield
    finally:
        sys.argv = argv
        if full is None:
            del os.environ["HYDRA_FULL_ERROR"]
        else:
            os.environ["HYDRA_FULL_ERROR"] = full
