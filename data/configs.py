"""Composition of the files in ``configs/`` with the words of a command line.

Hydra composes the configuration only: no folder, log file or change of directory of its own.
"""

from pathlib import Path
from typing import TYPE_CHECKING

from sim.errors import InputError

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
        InputError: an unknown key or group option, a word that is no override, a wrong type.
    """
    # Imported late: whoever only looks for a file in configs/ need not wait for Hydra.
    from hydra import compose, initialize_config_dir
    from hydra.errors import HydraException
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    try:
        with initialize_config_dir(version_base="1.3", config_dir=str(CONFIG_DIR)):
            config = compose(name, overrides=words)
        if schema is not None:
            config = OmegaConf.merge(OmegaConf.structured(schema), config)
        OmegaConf.resolve(config)
    except (HydraException, OmegaConfBaseException) as error:
        raise InputError(_first_lines(str(error))) from None
    return config


def _first_lines(message: str) -> str:
    """Hydra's complaint in one line, without its search path and links."""
    kept = []
    for line in message.splitlines():
        if line.startswith((
            "Config search path", "See https", "To append", "reference_type", "object_type")):
            break
        kept.append(line.strip())
    return " ".join(filter(None, kept))


def group_options(group: str) -> list[str]:
    """Names of the alternatives in ``configs/GROUP``."""
    return sorted(path.stem for path in (CONFIG_DIR / group).glob("*.yaml"))
