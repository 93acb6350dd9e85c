"""Parameters of user-written code: its signature declares them, and texts give their values
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
    """Return each parameter with its default as text; None: it has no default."""
    return {
        name: None if parameter.default is parameter.empty else _text(parameter.default)
        for name, parameter in _declared(code).items()
    }


def bind_parameters(code: Callable[..., Any], texts: Mapping[str, str]) -> Callable[..., Any]:
    """Bind the parameters of a function, or of a class before its instantiation.

    Raises `BadArguments` for an unknown, missing or mistyped parameter.
    """
    declared = _declared(code)
    for name in texts:
        if name not in declared:
            names = ", ".join(declared) or "none"
            raise BadArguments(f"there is no parameter {name!r}", f"its parameters are: {names}")
    for name, parameter in declared.items():
        if parameter.default is parameter.empty and name not in texts:
            raise BadArguments(f"parameter {name!r} has no default", f"give a value: {name}=…")
    values = {name: _value(name, declared[name], text) for name, text in texts.items()}
    return partial(code, **values) if values else code


def _declared(code: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    try:
        signature = inspect.signature(code)
    except (TypeError, ValueError):  # functions written in C have no signature
        return {}
    positional = inspect.Parameter.POSITIONAL_OR_KEYWORD if isinstance(code, type) else None
    return {
        name: found
        for name, found in signature.parameters.items()
        if found.kind in (inspect.Parameter.KEYWORD_ONLY, positional)
    }


def _kind(parameter: inspect.Parameter) -> type:
    """Return the type by the annotation, else by the default, else str."""
    annotation = parameter.annotation
    if isinstance(annotation, str):
        annotation = _KINDS.get(annotation, parameter.empty)
    if annotation in _KINDS.values():
        kind: type = annotation
        return kind
    if type(parameter.default) in _KINDS.values():
        return type(parameter.default)
    return str


def _value(name: str, parameter: inspect.Parameter, text: str) -> object:
    kind = _kind(parameter)
    try:
        return _BOOLEANS[text.lower()] if kind is bool else kind(text)
    except (KeyError, ValueError) as error:
        expected = {bool: "true or false", int: "a whole number", float: "a number"}[kind]
        raise BadArguments(f"parameter {name!r} must be {expected}, not {text!r}") from error


def _text(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
