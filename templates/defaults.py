"""Defaults of the parameters of templates: checked when a template is registered, and put in place
of what a request leaves out ([Events14 §IV.B]).

Law: a request without an argument equals the request with the default.
"""

from __future__ import annotations

from collections.abc import Callable

from pyoxigraph import Variable

from ..languages.arguments import Argument
from ..languages.csparql.ast import EventRequest, Template
from ..languages.errors import LanguageError
from ..languages.templates import AnyTemplate
from ..ontology.vocabulary import Vocabulary
from .instantiate import ArgumentError, argument_check, signature, wrong_count
from .reasoning import slots_of
from .slots import given_argument


def completed_arguments(template: AnyTemplate, request: EventRequest) -> tuple[Argument, ...]:
    """Return an argument for each parameter: the given one, else the default. Raises
    `ArgumentError` for a parameter that has neither, or two, and for a name that none has."""
    parameters, given = template.parameters, request.arguments
    names = [parameter.value for parameter in parameters]
    if len(given) > len(parameters):
        raise wrong_count(template, len(given))
    named = dict(request.named)
    for name in named:
        if name not in names:
            raise ArgumentError(
                f"no parameter is called ?{name}",
                hint=f"write {signature(template)}",
            )
        if name in names[: len(given)]:
            raise ArgumentError(
                f"?{name} is given twice: by its place and by its name",
                hint="leave one of the two out",
            )
    found: list[Argument] = list(given)
    for parameter, default in list(zip(parameters, template.defaults, strict=True))[len(given) :]:
        if parameter.value in named:
            found.append(named[parameter.value])
        elif default is None and named:
            message = f"{parameter} has no argument, and it has no default"
            raise ArgumentError(message, hint=f"write {signature(template)}")
        elif default is None:
            raise wrong_count(template, len(given))
        else:
            found.append(_free(default.value, (*found, *named.values())))
    return tuple(found)


def check_defaults(template: AnyTemplate, vocabulary: Vocabulary) -> None:
    """Check that each default could be an argument. Raises `LanguageError` at the default."""
    if not any(template.defaults):
        return
    check: Callable[[int, Argument], object]
    if isinstance(template, Template):
        check = argument_check(template, vocabulary)
    else:
        slots = slots_of(template, vocabulary)

        def check(index: int, argument: Argument) -> object:
            return given_argument(slots[index], argument, index, template.parameters[index])

    for index, default in enumerate(template.defaults):
        if default is None:
            continue
        try:
            check(index, default.value)
        except ArgumentError as error:
            name = template.parameters[index].value
            raise LanguageError(
                f"the default of `?{name}`: {error.reason}",
                template.source,
                default.span,
                error.hint,
            ) from error


def _free(default: Argument, others: tuple[Argument, ...]) -> Argument:
    """The default; a variable, whose name does not matter, is none of the others."""
    while isinstance(default, Variable) and default in others:
        default = Variable(f"{default.value}_")
    return default
