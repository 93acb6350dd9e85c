"""Checks SSL declarations against the ontology: it resolves names and compares units ([Events14
§IV.A]).

The papers leave these rules open. A name that the ontology defines as a sort is a sort. Any other
name is an object, known or new, unless `every` requires a sort. A plain name is looked up in the
stream's object namespace, then among the domain terms (`dyknow:`). A prefixed name or an IRI
denotes itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import assert_never

from ...ontology.units import (
    DIMENSIONLESS,
    Unit,
    UnitError,
    dimension,
    format_unit,
)
from ...ontology.vocabulary import SELF, Vocabulary
from ...rdf.namespaces import DYKNOW, local_name
from ...streams.sample import TIME_FIELDS
from ..errors import LanguageError, Span
from ..hints import meant
from ..ontology_names import OntologyNames
from . import annotation
from .annotation import (
    CheckedAnnotation,
    Content,
    PortAnnotation,
    Role,
    SourceAnnotation,
    StreamAnnotation,
    TransformationAnnotation,
)
from .ast import (
    Argument,
    CompunitDeclaration,
    Declaration,
    Entity,
    FeatureTerm,
    FieldFeature,
    SourceDeclaration,
    StreamDeclaration,
)


def check_ssl(
    declarations: Sequence[Declaration],
    source: str,
    vocabulary: Vocabulary,
    namespace: str = DYKNOW,
) -> tuple[CheckedAnnotation, ...]:
    """Return the meaning of the declarations of `parse_ssl(source)`, one annotation each, in order.

    ``namespace`` is that of new objects. Raises `LanguageError` at the first invalid name, unit or
    for-part; then nothing is declared.
    """
    checker = _Checker(source, vocabulary, namespace)
    declared: set[tuple[type[Declaration], str]] = set()
    for declaration in declarations:
        key = (type(declaration), declaration.name)
        if key in declared:
            raise checker.error(
                f"`{declaration.name}` is declared twice in this text",
                declaration.span,
                "one declaration says all that a stream contains",
            )
        declared.add(key)
    return tuple(checker.declaration(declaration) for declaration in declarations)


@dataclass(frozen=True, slots=True)
class _Checker:
    source: str
    vocabulary: Vocabulary
    namespace: str

    def error(self, message: str, span: Span, hint: str = "") -> LanguageError:
        return LanguageError(message, self.source, span, hint)

    def declaration(self, declaration: Declaration) -> CheckedAnnotation:
        text = self.source[declaration.span.start : declaration.span.end]
        match declaration:
            case StreamDeclaration():
                return StreamAnnotation(declaration.name, self.contents(declaration), text)
            case SourceDeclaration():
                made = self.output(declaration.output, (), declaration.entities)
                return SourceAnnotation(declaration.name, made, text)
            case CompunitDeclaration():
                inputs = self.inputs(declaration)
                made = self.output(declaration.output, inputs, declaration.entities)
                return TransformationAnnotation(declaration.name, inputs, made, text)
            case _:
                assert_never(declaration)

    # -- streams ---------------------------------------------------------------------------

    def contents(self, stream: StreamDeclaration) -> tuple[Content, ...]:
        self.check_entities(stream)
        contents: list[Content] = []
        declared: set[tuple[str, tuple[Role, ...]]] = set()
        for term in stream.features:
            span = Span(term.span.start, term.span.start + len(term.feature))
            feature = self.names.feature(term.feature, span)
            roles = self.roles(term, stream)
            unit = self.unit(feature, term.feature, term.unit, term.unit_span)
            self.names.check_arity(feature, term.feature, len(term.arguments), term.span)
            self.check_field(term.field, term.field_span)
            if (feature, roles) in declared:
                raise self.error(
                    f"`{term.feature}` of the same object is declared twice",
                    term.span,
                    "name each feature of an object once; another object needs another argument",
                )
            declared.add((feature, roles))
            contents.append(Content(feature, term.field, unit, roles))
        return tuple(contents)

    def check_field(self, field: str, span: Span) -> None:
        if field in TIME_FIELDS:
            raise self.error(
                f"a field cannot be called `{field}`: that is a sample's time",
                span,
                "give the field another name",
            )

    def check_entities(self, stream: StreamDeclaration) -> None:
        """Check that each entity names something in the features, once, and fits its `every`."""
        arguments = [argument for term in stream.features for argument in term.arguments]
        by_term: dict[str, Entity] = {}
        for entity in stream.entities:
            self.check_field(entity.field, entity.span)
            named = [argument for argument in arguments if self.is_named(argument, entity)]
            key = entity.name if any(a.alias for a in named) else self.term(entity)
            if key in by_term:
                raise self.error(
                    f"`{entity.name}` is named by two fields, "
                    f"`{by_term[key].field}` and `{entity.field}`",
                    entity.span,
                    "one field names it; distinguish two of a sort: `(UAV as a, UAV as b)`",
                )
            by_term[key] = entity
            if not named:
                names = sorted({argument.alias or argument.name for argument in arguments})
                raise self.error(
                    f"`{entity.name}` is not in the stream's features",
                    entity.span,
                    f"the features have the arguments {', '.join(names)}"
                    if names
                    else "the features have no arguments: leave the for-part out",
                )
            for argument in named:
                self.check_entity(entity, argument)

    def is_named(self, argument: Argument, entity: Entity) -> bool:
        """Return whether the entity names the argument. An alias hides the name of its argument."""
        if argument.alias is not None:
            return argument.alias == entity.name
        return argument.name == entity.name or self.term(argument) == self.term(entity)

    def term(self, named: Argument | Entity) -> str:
        """Resolve a name: a term of the ontology, else a new one."""
        iris = self.names.iris(named.name, named.span)
        vocabulary = self.vocabulary
        return next(
            (iri for iri in iris if vocabulary.is_sort(iri) or vocabulary.is_object(iri)), iris[0]
        )

    def check_entity(self, entity: Entity, argument: Argument) -> None:
        sort = self.sort(argument)
        if entity.every and sort is None:
            known_object = any(
                self.vocabulary.is_object(iri)
                for iri in self.names.iris(argument.name, argument.span)
            )
            near = self.vocabulary.suggest(argument.name, "sort")
            if known_object or not near:
                hint = f"write `for {entity.name} = {entity.field}` if it is an object"
            else:
                hint = meant(near)
            what = "an object" if known_object else "not a sort of the ontology"
            raise self.error(
                f"`every` needs a sort, and `{argument.name}` is {what}", entity.span, hint
            )
        if not entity.every and sort is not None:
            raise self.error(
                f"`{argument.name}` is a sort, not an object",
                entity.span,
                f"write `for every {entity.name} = {entity.field}`",
            )

    def roles(self, term: FeatureTerm, stream: StreamDeclaration) -> tuple[Role, ...]:
        roles: list[Role] = []
        by_name: dict[str, Argument] = {}
        by_field: dict[str, Argument] = {}
        for argument in term.arguments:
            name = argument.alias or argument.name
            sort = self.sort(argument)
            if name in by_name and (sort is not None or argument.alias is not None):
                raise self.error(
                    f"`{name}` occurs twice in `{term.feature}`, which is ambiguous",
                    argument.span,
                    f"give each an alias: `({argument.name} as arg1, {argument.name} as arg2)`",
                )
            by_name[name] = argument
            entity = next((e for e in stream.entities if self.is_named(argument, e)), None)
            if entity is not None:
                if entity.field in by_field and by_field[entity.field].name != name:
                    raise self.error(
                        f"field `{entity.field}` names two arguments of `{term.feature}`",
                        entity.span,
                        "each argument needs a field of its own",
                    )
                by_field[entity.field] = argument
            field = None if entity is None else entity.field
            if sort is None:
                roles.append(Role(None, self.object(argument), field))
            elif field is None:
                raise self.error(
                    f"`{argument.name}` is a sort, and no field names the object",
                    argument.span,
                    f"write `for every {name} = id`, where id is the field that names the object",
                )
            else:
                roles.append(Role(sort, None, field))
        return tuple(roles)

    # -- names -----------------------------------------------------------------------------

    @property
    def names(self) -> OntologyNames:
        return OntologyNames(self.source, self.vocabulary, self.namespace)

    def sort(self, argument: Argument) -> str | None:
        """Return the IRI of the sort that an argument names; None for an object."""
        return self.names.find_sort(argument.name, argument.span)

    def object(self, argument: Argument) -> str:
        return self.names.object(argument.name, argument.span)

    # -- units and ports -------------------------------------------------------------------

    def unit(self, feature: str, name: str, unit: Unit | None, span: Span | None) -> Unit:
        """Return the written unit if its dimension is that of the feature; without one the
        feature's own."""
        info = self.vocabulary.feature(feature)
        own = None if info is None else info.unit
        if unit is None or span is None:
            return own or ()
        try:
            written_dimension = dimension(unit)
            own_dimension = DIMENSIONLESS if own is None else dimension(own)
        except UnitError as error:
            hint = f"`{name}` is in [{format_unit(own)}]" if own else f"`{name}` has no unit"
            raise self.error(str(error), span, hint) from None
        if written_dimension == own_dimension:
            return unit
        if not own:
            raise self.error(
                f"`{name}` has no unit in the ontology, so {format_unit(unit)} cannot be its unit",
                span,
                "leave the unit out, or give the feature a :hasUnit in the ontology",
            )
        raise self.error(
            f"`{name}` measures {own_dimension}, but {format_unit(unit)} is {written_dimension}",
            span,
            f"`{name}` is in [{format_unit(own)}]: write it or another unit of {own_dimension}",
        )

    def inputs(self, unit: CompunitDeclaration) -> tuple[PortAnnotation, ...]:
        names: set[str] = set()
        for port in unit.inputs:
            if port.field in names:
                raise self.error(
                    f"two inputs have the name `{port.field}`", port.span, "each needs its own name"
                )
            names.add(port.field)
        return tuple(self.port(port) for port in unit.inputs)

    def port(self, port: FieldFeature) -> PortAnnotation:
        feature = self.names.feature(port.feature, port.feature_span)
        unit = self.unit(feature, port.feature, port.unit, port.unit_span)
        arguments = tuple(self.argument(argument) for argument in port.arguments or ())
        if arguments:
            self.names.check_arity(feature, port.feature, len(arguments), port.span)
        names = [argument.variable for argument in arguments if argument.sort is not None]
        if len(names) > len(set(names)):
            twice = next(name for name in names if names.count(name) > 1)
            raise self.error(
                f"`{twice}` occurs twice in `{port.feature}`, which is ambiguous",
                port.span,
                f"give each an alias: `({twice} as arg1, {twice} as arg2)`",
            )
        return PortAnnotation(port.field, feature, unit, arguments)

    def argument(self, argument: Argument) -> annotation.Argument:
        variable = argument.alias or variable_name(argument.name)
        sort = self.sort(argument)
        if sort is not None:
            return annotation.Argument(variable, sort)
        object = SELF if argument.name == "self" else self.object(argument)
        return annotation.Argument(variable, None, object)

    def output(
        self,
        port: FieldFeature,
        inputs: Sequence[PortAnnotation],
        entities: Sequence[Entity],
    ) -> PortAnnotation:
        """Return the output. Objects that no input contains get a field of the output for their
        names."""
        made = self.port(port)
        self.check_field(port.field, port.span)
        in_inputs = {argument.variable for input in inputs for argument in input.arguments}
        if any(not input.arguments for input in inputs):
            # Such an input concerns the objects of the output.
            in_inputs |= {argument.variable for argument in made.arguments}
        for each in entities:
            self.check_field(each.field, each.span)
        fields = {variable_name(entity.name): entity for entity in entities}
        arguments: list[annotation.Argument] = []
        for argument in made.arguments:
            entity = fields.pop(argument.variable, None)
            if argument.sort is None or argument.variable in in_inputs:
                if entity is not None:
                    raise self.error(
                        f"`{entity.name}` is an object of the inputs, which no output field names",
                        entity.span,
                        "leave it out: the output distinguishes the objects of the inputs",
                    )
                arguments.append(argument)
                continue
            field = "id" if entity is None else entity.field
            if field == made.field:
                raise self.error(
                    f"field `{field}` is the value of `{port.feature}`",
                    port.span if entity is None else entity.span,
                    f"another field names the object: `for every {argument.variable} = …`",
                )
            arguments.append(replace(argument, id_field=field))
        for entity in fields.values():
            raise self.error(
                f"`{entity.name}` is not an argument of the output",
                entity.span,
                f"name it in the output: `{port.field}:{port.feature}({entity.name})`",
            )
        id_fields = [argument.id_field for argument in arguments if argument.id_field is not None]
        if len(id_fields) > len(set(id_fields)):
            raise self.error(
                "one field cannot name two objects",
                port.span,
                "give each its own: `for every "
                + ", ".join(f"{a.variable} = {a.variable.lower()}" for a in arguments)
                + "`",
            )
        return replace(made, arguments=tuple(arguments))


def variable_name(name: str) -> str:
    """Return the last part of a name or an IRI, with letters, digits and `_` only."""
    text = local_name(name.rstrip(">"))
    return "".join(c if c.isalnum() or c == "_" else "_" for c in text)
