"""Checks KPL declarations against the running system.

The language's checker compares them with other declarations; this module compares them with the
existing streams, names and code.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import assert_never

from ...languages.kpl import (
    CheckedDeclaration,
    CompunitDeclaration,
    Compute,
    ForeachDeclaration,
    GeneratorDeclaration,
    Signature,
    SinkDeclaration,
    SortDeclaration,
    SourceDeclaration,
    StreamDeclaration,
    ValueSort,
    format_kpl,
)
from ..configuration.configuration import Configuration
from ..model.errors import AlreadyExists, Conflict, Refused, UnknownFeature
from ..processes.registry import Processes, SinkImplementation, UnitImplementation
from .network import Network, schema_text, sort_name


class Admission:
    """Checks the declarations of a text before any is started. Changes nothing.

    In a ``rehearsal`` sinks need no code; ``check_name`` raises `Refused` for reserved names.
    `check` raises `UnknownFeature` for a process without code, `Conflict` where code or a stream
    differs from its declaration, `AlreadyExists` for the name of another stream.
    """

    def __init__(
        self,
        configuration: Configuration,
        processes: Processes,
        network: Network,
        check_name: Callable[[str], None],
        *,
        rehearsal: bool,
    ) -> None:
        self._configuration = configuration
        self._processes = processes
        self._network = network
        self._check_name = check_name
        self._rehearsal = rehearsal

    def check(self, declaration: CheckedDeclaration, signature: Signature) -> None:
        """Raise an error unless ``declaration`` can start beside those of ``signature``."""
        match declaration:
            case SourceDeclaration(name, sort):
                self._check_source(name, sort)
            case GeneratorDeclaration():
                self._check_free(declaration.key)
                self._check_code(declaration, signature)
            case StreamDeclaration(name):
                self._check_free(name)
            case CompunitDeclaration(name):
                self._check_name(name)
                implementation = self._processes.units.get(name)
                if implementation is not None:
                    _check_sorts(declaration, implementation)
            case ForeachDeclaration(_, _, generators):
                for generator in generators:
                    self._check_code(generator, signature)
            case SinkDeclaration(name):
                self._check_name(name)
                self.sink_implementation(declaration)
            case SortDeclaration():
                pass
            case _:
                assert_never(declaration)

    def _check_source(self, name: str, sort: ValueSort) -> None:
        implementation = self._processes.sources.get(name)
        if implementation is not None and sort_name(implementation.sort) != sort.name:
            raise Conflict(
                f"source {name!r} is declared with values of sort {sort.name}, "
                f"its code returns {implementation.sort}",
                f"declare `source {sort_name(implementation.sort)} {name}`, "
                "or change its decorator",
            )
        existing = self._configuration.streams.get(name)
        if existing is None:
            self._check_free(name)
            return
        if self._configuration.is_made_by_system(name):
            raise Refused(
                f"stream {name!r} is made by the system, so it cannot be a source",
                "a source is a stream that you publish to, or a process with @dyknow.source",
            )
        if implementation is not None and not self._rehearsal:
            raise Conflict(
                f"there is a stream {name!r} already, and code with @dyknow.source of that name",
                "remove the stream first, or give the code another name",
            )
        if existing.is_open or sort.schema is None:
            return
        if not set(sort.schema.fields) <= set(existing.schema.fields):
            raise Conflict(
                f"stream {name!r} has the fields {schema_text(existing.schema)}; "
                f"the sort {sort.name} has {schema_text(sort)}",
                "declare a sort with the fields of the stream: "
                f"sort {sort.name} = ({schema_text(existing.schema)})",
            )

    def _check_free(self, name: str) -> None:
        if self._configuration.has(name):
            raise AlreadyExists(
                f"there is a stream called {name!r} already",
                "choose another name; a stream that you publish to may be declared as a source",
            )
        self._check_name(name)

    def _check_code(self, declaration: GeneratorDeclaration, signature: Signature) -> None:
        if isinstance(declaration.process, Compute):
            name = declaration.process.unit
            implementation = self._network.implementation(name, declaration.key)
            compunit = signature.compunit(name)
            if compunit is not None:
                _check_sorts(compunit, implementation)

    def sink_implementation(self, declaration: SinkDeclaration) -> SinkImplementation | None:
        """The code of a sink; None in a rehearsal."""
        if self._rehearsal:
            return None
        implementation = self._processes.sinks.get(declaration.name)
        if implementation is None:
            names = ", ".join(self._processes.sinks) or "none"
            raise UnknownFeature(
                f"sink {declaration.name!r} has no implementation",
                f"write it with @dyknow.sink and load its module; there are: {names}",
            )
        if len(implementation.inputs) != len(declaration.terms):
            raise Conflict(
                f"sink {implementation.name!r} is declared with {len(declaration.terms)} inputs, "
                f"its code takes {len(implementation.inputs)}",
                "make the declaration and the decorator the same",
            )
        return implementation


def _check_sorts(declaration: CompunitDeclaration, implementation: UnitImplementation) -> None:
    """Raise `Conflict` unless the value sorts in KPL (Def. 5.16) are those of the decorator."""
    declared = (declaration.sort.name, *(sort.name for sort in declaration.inputs))
    coded = tuple(map(sort_name, (implementation.output, *implementation.inputs)))
    if declared != coded:
        text = f"compunit {coded[0]} {implementation.name}({', '.join(coded[1:])})"
        raise Conflict(
            f"computational unit {implementation.name!r} is declared as "
            f"`{format_kpl(declaration)}`, its code as `{text}`",
            "make the declaration and the decorator the same",
        )
