"""Arrays are checked against the types of :mod:`common.types` while the tests run.

Modules of :data:`PACKAGES` that are imported after this one have their functions, methods,
properties and constructors wrapped: arguments and results must have the shapes and dtypes that
their annotations state, and a letter stands for one number within a call. Nothing is checked in
worker processes, which import the modules themselves.
"""

import re
import sys
from collections.abc import Callable, Sequence
from functools import cached_property, wraps
from importlib.machinery import ModuleSpec, PathFinder
from inspect import Parameter, signature
from types import FunctionType, ModuleType, NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import numpy as np

PACKAGES = ("sim", "data", "drapenet")
enabled = True
"""False in tests that give wrong arrays on purpose, see the fixture ``any_shapes``."""
_DTYPES = {"float": np.floating, "int": np.integer, "bool": np.bool_, "uint8": np.uint8,
           None: np.number}
_TEXT = re.compile(r"\((?P<shape>[^)]+)\)(?: (?P<dtype>float|int|bool|uint8)\b)?")

_BY_PLACE = (Parameter.POSITIONAL_ONLY, Parameter.POSITIONAL_OR_KEYWORD)

Sizes = dict[str, int]
"""Numbers that letters stand for in one call."""
Rule = Callable[[Any, Sizes], bool]
"""Whether a value is as an annotation states; binds letters."""


class ShapeError(BaseException):
    """An array is not what its annotation states. No ``except Exception`` may hide it."""


class _Array:
    """The rule of an array: what its text states."""

    def __init__(self, text: re.Match) -> None:
        self.dtype = _DTYPES[text["dtype"]]
        sizes = [size.strip() for size in text["shape"].split(",") if size.strip()]
        self.open = sizes[0] == "..."  # any number of axes come first
        self.sizes = [int(size) if size.isdigit() else size for size in sizes[self.open:]]

    def __call__(self, value: Any, sizes: Sizes) -> bool:
        if not isinstance(value, np.ndarray) or not issubclass(value.dtype.type, self.dtype):
            return False
        surplus = value.ndim - len(self.sizes)
        if surplus < 0 or (surplus and not self.open):
            return False
        for length, size in zip(value.shape[surplus:], self.sizes, strict=True):
            if isinstance(size, str) and size.isidentifier() and size != "any":
                size = sizes.setdefault(size, length)
            if isinstance(size, int) and length != size:
                return False  # sums of letters are not checked
        return True


def rule_of(kind: Any) -> Rule | None:
    """The rule of an annotation; None if it has no array of a stated shape."""
    parts = get_args(kind)
    if get_origin(kind) is Annotated:
        text = parts[0] is np.ndarray and isinstance(parts[1], str) and _TEXT.match(parts[1])
        return _Array(text) if text else None
    rules = [rule_of(part) for part in parts]
    origin = get_origin(kind)
    if not any(rules):
        return None
    if origin in (Union, UnionType):
        return _either(parts, rules)
    if origin is tuple and Ellipsis not in parts:
        return lambda value, sizes: len(value) == len(rules) and all(
            rule is None or rule(part, sizes) for part, rule in zip(value, rules, strict=True))
    if origin in (list, tuple, Sequence):
        return lambda value, sizes: all(rules[0](part, dict(sizes)) for part in value)
    return None


def _either(parts: tuple, rules: list[Rule | None]) -> Rule:
    """The rule of a union, which distinguishes arrays and None only."""
    others = any(rule is None and part is not NoneType
                 for part, rule in zip(parts, rules, strict=True))

    def holds(value: Any, sizes: Sizes) -> bool:
        if value is None:
            return NoneType in parts
        if others and not isinstance(value, np.ndarray):
            return True
        return any(rule(value, sizes) for rule in rules if rule)

    return holds


def checked(function: FunctionType) -> FunctionType:
    """The function with its arguments and result checked, itself if it states no shapes."""
    kinds = getattr(function, "__annotations__", {})
    rules = {name: rule for name, kind in kinds.items() if (rule := rule_of(kind))}
    if not rules:
        return function
    returned = rules.pop("return", None)
    parameters = signature(function).parameters.values()
    in_order = [each.name for each in parameters if each.kind in _BY_PLACE]
    placed = [(rules.get(name), name) for name in in_order]

    def require(rule: Rule, name: str, value: Any, sizes: Sizes) -> None:
        if not rule(value, sizes):
            what = (f"{value.shape} {value.dtype}" if isinstance(value, np.ndarray)
                    else f"a {type(value).__name__}")
            raise ShapeError(f"{function.__module__}.{function.__qualname__}: {name} is {what}, "
                             f"not {kinds[name]}, where {sizes}")

    @wraps(function)
    def wrapper(*args: Any, **kwargs: Any) -> Any:
        if not enabled:
            return function(*args, **kwargs)
        sizes: Sizes = {}
        for (rule, name), value in zip(placed, args, strict=False):
            if rule:
                require(rule, name, value, sizes)
        for name, value in kwargs.items():
            if rule := rules.get(name):
                require(rule, name, value, sizes)
        result = function(*args, **kwargs)
        if returned:
            require(returned, "return", result, sizes)
        return result

    return wrapper


def check_module(module: ModuleType) -> None:
    """Wrap the functions and classes that a module defines."""
    for name, item in list(vars(module).items()):
        if getattr(item, "__module__", None) != module.__name__:
            continue
        if isinstance(item, FunctionType):
            setattr(module, name, checked(item))
        elif isinstance(item, type):
            check_class(item)


def check_class(kind: type) -> None:
    """Wrap the methods and properties of a class, and its constructor."""
    for name, item in list(vars(kind).items()):
        if isinstance(item, FunctionType):
            new: Any = checked(item)
        elif isinstance(item, staticmethod | classmethod):
            new = type(item)(checked(item.__func__))
        elif isinstance(item, property):
            new = item.getter(checked(item.fget))
        elif isinstance(item, cached_property):
            item.func, new = checked(item.func), item
        else:
            continue
        if new is not item:
            setattr(kind, name, new)


class _Finder:
    """Finds modules of :data:`PACKAGES`, which are wrapped after their code has run."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, target: object = None
                  ) -> ModuleSpec | None:
        """See :class:`importlib.abc.MetaPathFinder`."""
        if name.partition(".")[0] not in PACKAGES:
            return None
        spec = PathFinder.find_spec(name, path)
        if spec and spec.loader:
            run = spec.loader.exec_module

            def run_and_check(module: ModuleType) -> None:
                run(module)
                check_module(module)

            spec.loader.exec_module = run_and_check  # type: ignore[method-assign]
        return spec


sys.meta_path.insert(0, _Finder)
