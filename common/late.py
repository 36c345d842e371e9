"""Public names of a package that are loaded when they are asked for."""

import sys
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any


def late(package: str, names: Mapping[str, Sequence[str]]
         ) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """``__getattr__`` and ``__dir__`` of a ``package`` with ``names`` of other modules."""
    home = {name: module for module, listed in names.items() for name in listed}

    def value(name: str) -> Any:
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(home[name]), name)

    return value, lambda: sorted({*vars(sys.modules[package]), *home})
