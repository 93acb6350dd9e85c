"""Instantiation: a template and arguments make a continuous query ([Events14 §V.B]).

``HighSpeedEvent(?o, ?type, ?threshold)`` with ``(dyknow:uav1, dyknow:UAV, 100)`` is the query of
Listing 4 with these terms bound. Each argument is checked against the places of its parameter in
the body, so that a request that can never produce an event is refused.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import assert_never

from pyoxigraph import BlankNode, Literal, NamedNode, Variable

from ..languages.arguments import Argument, argument_text
from ..languages.csparql import bind, body_tree, required_parameters, term_text
from ..languages.csparql.ast import ContinuousQuery, Template
from ..languages.hints import count, meant
from ..languages.templates import AnyTemplate
from ..ontology.vocabulary import Vocabulary
from ..rdf.dictionary import Term
from ..rdf.namespaces import shorten
from .places import Place, is_numeric, places

_INTEGER = re.compile(r"[+-]?[0-9]+")
_DECIMAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)")
_DOUBLE = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")


class ArgumentError(ValueError):
    """An argument does not fit its parameter. ``index`` counts from 0.

    ``index`` and ``parameter`` are None if the number of arguments is wrong.
    """

    def __init__(
        self,
        message: str,
        index: int | None = None,
        parameter: str | None = None,
        hint: str = "",
        reason: str = "",
    ) -> None:
        super().__init__(message)
        self.message = message
        self.reason = reason or message
        """The message without the place of the argument."""
        self.index = index
        self.parameter = parameter
        self.hint = hint


def instantiate(
    template: Template, arguments: Sequence[Argument], vocabulary: Vocabulary
) -> ContinuousQuery:
    """Return the template's query with ``arguments`` bound as terms, in the order of the
    parameters.

    A variable (with any name) leaves its parameter free: the query then covers every object that
    the body matches. Raises `ArgumentError` for a wrong number of arguments; for an unknown class
    or predicate; for a subject that is no IRI; for a number that is malformed, infinite or NaN; and
    for a variable where the body binds no value (a threshold).
    """
    check_count(template, arguments)
    check = argument_check(template, vocabulary)
    bindings: dict[Variable, Term] = {}
    for index, argument in enumerate(arguments):
        check(index, argument)
        parameter = template.parameters[index]
        if not isinstance(argument, Variable):
            bindings[parameter] = argument
        elif argument in arguments[:index]:
            raise used_twice(argument, index, parameter)
    return bind(template.query, bindings)


def argument_check(template: Template, vocabulary: Vocabulary) -> Callable[[int, Argument], None]:
    """Return what checks an argument alone, by its index. It raises `ArgumentError`."""
    stand = places(body_tree(template.query), vocabulary)
    required = required_parameters(template)

    def check(index: int, argument: Argument) -> None:
        parameter = template.parameters[index]
        kinds = stand.get(parameter.value, frozenset())
        if isinstance(argument, Variable):
            if parameter in required:
                raise _no_value(argument, index, parameter, kinds)
            return
        for place in Place:
            if place in kinds:
                _check_term(argument, place, index, parameter, vocabulary)
        if isinstance(argument, BlankNode):
            raise argument_error(
                "a blank node names nothing outside its own text", index, parameter
            )

    return check


def check_count(template: AnyTemplate, arguments: Sequence[Argument]) -> None:
    """Raise `ArgumentError` for a wrong number of arguments."""
    if len(arguments) != len(template.parameters):
        raise wrong_count(template, len(arguments))


def wrong_count(template: AnyTemplate, number: int) -> ArgumentError:
    """Return the error of a request with this number of arguments."""
    most = len(template.parameters)
    least = template.defaults.count(None)
    takes = count(most, "argument") if least == most else f"{least} to {count(most, 'argument')}"
    return ArgumentError(
        f"{shorten(template.name)} takes {takes}, not {number}", hint=f"write {signature(template)}"
    )


def used_twice(argument: Argument, index: int, parameter: Variable) -> ArgumentError:
    """Return the error of a variable that an argument before it is, too."""
    return argument_error(
        f"{argument} is used for two arguments",
        index,
        parameter,
        f"leave the second free under a name of its own: ?{parameter.value}",
    )


def _no_value(
    argument: Variable, index: int, parameter: Variable, kinds: frozenset[Place]
) -> ArgumentError:
    needed = Place.NUMBER.value if Place.NUMBER in kinds else "a value"
    return argument_error(
        f"?{parameter.value} must be given: nothing in the template finds a value for it",
        index,
        parameter,
        f"give {needed} instead of {argument}" + (", for example 100" if "num" in needed else ""),
    )


def _check_term(
    argument: Term, place: Place, index: int, parameter: Variable, vocabulary: Vocabulary
) -> None:
    match place:
        case Place.SORT:
            iri = _iri(argument, place, index, parameter, "dyknow:UAV")
            if not vocabulary.is_sort(iri):
                hint = suggestion(vocabulary.suggest(iri, "sort"))
                raise argument_error(f"{shorten(iri)} is not a known sort", index, parameter, hint)
        case Place.PREDICATE:
            iri = _iri(argument, place, index, parameter, "dyknow:speed")
            if not (vocabulary.is_feature(iri) or vocabulary.is_event(iri)):
                hint = suggestion(vocabulary.suggest(iri, "feature"))
                raise argument_error(
                    f"{shorten(iri)} is not a known feature", index, parameter, hint
                )
        case Place.SUBJECT:
            _iri(argument, place, index, parameter, "dyknow:uav1")
        case Place.NUMBER:
            problem = number_problem(argument)
            if problem:
                raise argument_error(
                    problem, index, parameter, "give a finite number, for example 100"
                )
        case _:
            assert_never(place)


def _iri(argument: Term, place: Place, index: int, parameter: Variable, example: str) -> str:
    if isinstance(argument, NamedNode):
        return argument.value
    given = "a blank node" if isinstance(argument, BlankNode) else f"the literal {_text(argument)}"
    raise argument_error(
        f"?{parameter.value} stands for {place.value}: expected an IRI, found {given}",
        index,
        parameter,
        f"write a name such as {example}",
    )


def number_problem(term: Term) -> str:
    """Return why ``term`` is no finite number; empty if it is one."""
    if not isinstance(term, Literal):
        return f"{_text(term)} is not a literal"
    if not is_numeric(term.datatype.value):
        return f"{_text(term)} is not a number"
    kind = term.datatype.value.rpartition("#")[2]
    if kind in ("float", "double"):
        pattern = _DOUBLE
    else:
        pattern = _DECIMAL if kind == "decimal" else _INTEGER
    if not pattern.fullmatch(term.value):
        if term.value in ("NaN", "INF", "+INF", "-INF"):
            return f"{term.value} is not finite"
        return f"{term.value!r} is not an xsd:{kind}"
    # A double may overflow to infinity: 1e999.
    return f"{term.value} is not finite" if _overflows(term.value) else ""


def _overflows(text: str) -> bool:
    return abs(float(text)) == float("inf")


def suggestion(near: Sequence[str]) -> str:
    """Return a hint with similar names."""
    return meant([name if name.startswith("<") else f"dyknow:{name}" for name in near])


def argument_error(message: str, index: int, parameter: Variable, hint: str = "") -> ArgumentError:
    """Return the error of the argument at ``index``, from 0."""
    return ArgumentError(
        f"argument {index + 1} (?{parameter.value}): {message}",
        index,
        parameter.value,
        hint,
        message,
    )


def _text(term: Term) -> str:
    if isinstance(term, NamedNode):
        return shorten(term.value)
    return str(term) if isinstance(term, BlankNode) else term_text(term)


def signature(template: AnyTemplate) -> str:
    """Return the event with its parameters and their defaults."""
    return f"{shorten(template.name)}({', '.join(parameter_texts(template))})"


def parameter_texts(template: AnyTemplate) -> tuple[str, ...]:
    """Return the parameters with their defaults, as in a request that names them."""
    return tuple(
        str(parameter) if default is None else f"{parameter} = {argument_text(default.value)}"
        for parameter, default in zip(template.parameters, template.defaults, strict=True)
    )
