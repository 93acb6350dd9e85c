"""Parameters of user-written code: what its signature declares, and texts made into values
([Introspection15 §3.1]: a transformation is an implementation together with parameters).

A class takes its parameters in its constructor, a function as keyword-only arguments.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from ..model.errors import BadArguments

_KINDS = {"bool": bool, "int": int, "float": float, "str": str}
_BOOLEANS = {"true": True, "false": False}


def defaults_of(code: Callable[..., Any]) -> dict[str, str | None]:
    """Each parameter with its default as text; None: it must be given."""
    return {
        name: None if parameter.default is parameter.empty else _text(parameter.default)
        for name, parameter in _declared(code).items()
    }


def bind_parameters(code: Callable[..., Any], texts: Mapping[str, str]) -> Callable[..., Any]:
    """``code`` with the parameters of these texts: a class still to be instantiated, a function.

    Raises `BadArguments` for a parameter that it has not, or that is missing or of another type.
    """
    declared = _declared(code)
    for name in texts:
        if name not in declared:
            known = ", ".join(declared) or "none"
            raise BadArguments(f"there is no parameter {name!r}", f"its parameters are: {known}")
    for name, parameter in declared.items():
        if parameter.default is parameter.empty and name not in texts:
            raise BadArguments(f"parameter {name!r} has no default", f"give a value: {name}=…")
    values = {name: _value(name, declared[name], text) for name, text in texts.items()}
    return partial(code, **values) if values else code


def _declared(code: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    try:
        signature = inspect.signature(code)
    except (TypeError, ValueError):  # a function written in C has none
        return {}
    positional = inspect.Parameter.POSITIONAL_OR_KEYWORD if isinstance(code, type) else None
    return {
        name: found
        for name, found in signature.parameters.items()
        if found.kind in (inspect.Parameter.KEYWORD_ONLY, positional)
    }


def _kind(parameter: inspect.Parameter) -> type:
    """What the annotation says, else what the default is, else text."""
    named = parameter.annotation
    if isinstance(named, str):
        named = _KINDS.get(named, parameter.empty)
    if named in _KINDS.values():
        found: type = named
        return found
    if type(parameter.default) in _KINDS.values():
        return type(parameter.default)
    return str


def _value(name: str, parameter: inspect.Parameter, text: str) -> object:
    kind = _kind(parameter)
    try:
        return _BOOLEANS[text.lower()] if kind is bool else kind(text)
    except (KeyError, ValueError) as error:
        what = {bool: "true or false", int: "a whole number", float: "a number"}[kind]
        raise BadArguments(f"parameter {name!r} is {what}, not {text!r}") from error


def _text(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
