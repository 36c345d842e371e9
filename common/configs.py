"""Reading the files in ``configs/`` without Hydra."""

from pathlib import Path

import yaml

from common.errors import InputError

CONFIG_DIR = Path(__file__).resolve().parent.parent / "configs"


def config_text(name: str) -> str:
    """The file ``configs/NAME.yaml``, with its comments."""
    return (CONFIG_DIR / f"{name}.yaml").read_text(encoding="utf-8")


def read_config(name: str) -> dict:
    """The content of ``configs/NAME.yaml``."""
    return yaml.safe_load(config_text(name))


def group_options(group: str) -> list[str]:
    """Names of the options in ``configs/GROUP``."""
    return sorted(path.stem for path in (CONFIG_DIR / group).glob("*.yaml"))


def read_option(group: str, name: str) -> dict:
    """The content of ``configs/GROUP/NAME.yaml``; InputError when there is no such file."""
    known = group_options(group)
    if name not in known:
        raise InputError(f"unknown {group} {name!r}; known {group}s: {', '.join(known)}")
    return read_config(f"{group}/{name}")
