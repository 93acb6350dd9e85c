"""Transformations that people register and annotate ([Introspection15 §3.1, §4.2]).

What a transformation takes and gives, what code with which parameters is behind it, what a unit of
it costs and how good its output is; and what of it is remembered over a restart.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace

from ...languages.ssl import check_ssl, parse_ssl
from ...languages.ssl.annotation import (
    Argument,
    PortAnnotation,
    SourceAnnotation,
    StreamAnnotation,
    TransformationAnnotation,
)
from ...matching.words import unit_words
from ...ontology.ontology import Ontology
from ...ontology.units import format_unit, parse_unit
from ..configuration.configuration import Configuration
from ..model.errors import (
    AlreadyExists,
    BadArguments,
    Conflict,
    UnknownTransformation,
)
from ..model.status_changes import Change, ChangeKind, KnownTransformation
from .iri_annotations import DescribedTransformation, Describer, check_inputs
from .transformation_library import LIBRARY_NAMES, Transformation, Transformations


@dataclass(frozen=True, slots=True)
class TransformationView:
    """A transformation as the service shows it; ``lacks`` says why no unit can be made of it."""

    name: str
    text: str
    annotation: TransformationAnnotation | SourceAnnotation
    implementation: str
    parameters: Mapping[str, str]
    cost: float
    quality: float
    lacks: str
    units: tuple[str, ...]


class RegisteredTransformations:
    """Registers, annotates, keeps and forgets transformations; every change is told, several of
    them ``together``."""

    def __init__(
        self,
        ontology: Ontology,
        transformations: Transformations,
        configuration: Configuration,
        changed: Callable[[Change], None],
        check_name: Callable[[str], None],
        together: Callable[[], AbstractContextManager[None]],
    ) -> None:
        self._ontology = ontology
        self._transformations = transformations
        self._configuration = configuration
        self._changed = changed
        self._check_name = check_name
        self._together = together

    def views(self) -> tuple[TransformationView, ...]:
        """All transformations, in the order of registration."""
        return self._views(self._transformations)

    def view(self, name: str) -> TransformationView:
        """One transformation; raises `UnknownTransformation`."""
        units = self._configuration.units.values()
        return self._view(name, [unit.name for unit in units if unit.transformation == name])

    def _views(self, names: Iterable[str]) -> tuple[TransformationView, ...]:
        """Cost: one look at all units."""
        units: dict[str, list[str]] = {}
        for unit in self._configuration.units.values():
            units.setdefault(unit.transformation, []).append(unit.name)
        return tuple(self._view(name, units.get(name, ())) for name in names)

    def _view(self, name: str, units: Sequence[str]) -> TransformationView:
        known = self.get(name)
        description = self._transformations.describe(known)
        parameters = known.parameters
        if not description.lacks:
            parameters = self._transformations.parameters_of(known)
        return TransformationView(
            name=known.name,
            text=unit_words(description),
            annotation=known.annotation,
            implementation=known.implementation,
            parameters=dict(parameters),
            cost=known.cost,
            quality=known.quality,
            lacks=description.lacks,
            units=tuple(units),
        )

    def get(self, name: str) -> Transformation:
        """A transformation by name; raises `UnknownTransformation`."""
        found = self._transformations.get(name)
        if found is None:
            known = ", ".join(self._transformations)
            raise UnknownTransformation(
                f"there is no transformation called {name!r}", f"there are: {known}"
            )
        return found

    def register_described(
        self, described: DescribedTransformation, *, replace: bool = False
    ) -> TransformationView:
        """Make a transformation known that is described in names; see `register`."""
        (view,) = self.register_all([described], replace=replace)
        return view

    def register_all(
        self, described: Sequence[DescribedTransformation], *, replace: bool = False
    ) -> tuple[TransformationView, ...]:
        """Make transformations known that are described in names, all of them or none; see
        `register`."""
        describer = Describer(self._ontology.vocabulary)
        made = [describer.transformation(each) for each in described]
        names = [each.name for each in made]
        for name, number in Counter(names).items():
            if number > 1:
                raise BadArguments(f"{name!r} is described twice", "give each its own name")
        for each in made:
            self._admit(each, replace)
        with self._together():
            for each in made:
                self._keep(each)
        return self._views(names)

    def register_annotated(
        self,
        ssl: str,
        *,
        implementation: str | None = None,
        parameters: Mapping[str, str] | None = None,
        cost: float = 1.0,
        quality: float = 1.0,
        replace: bool = False,
    ) -> TransformationView:
        """Make the source or unit known that an SSL text annotates; see `register`. Raises
        `LanguageError`, and `BadArguments` where the text annotates anything else."""
        checked = check_ssl(parse_ssl(ssl), ssl, self._ontology.vocabulary)
        annotation = checked[0] if len(checked) == 1 else None
        if annotation is None or isinstance(annotation, StreamAnnotation):
            raise BadArguments(
                "the annotation of a transformation is one declaration",
                "write `compunit NAME transforms … to …`, or `source NAME provides …`",
            )
        code = implementation or annotation.name
        known = Transformation(annotation, code, dict(parameters or {}), cost, quality)
        self.register(known, replace=replace)
        return self.view(known.name)

    def register(self, transformation: Transformation, *, replace: bool = False) -> None:
        """Make a transformation known; matching uses it from now on.

        Raises `AlreadyExists` unless ``replace``, `Refused` for a name that is the system's own,
        `BadArguments`, `Conflict` and `UnknownFeature` where annotation, code and parameters do
        not fit together. Units that run already are left as they are.
        """
        self._admit(transformation, replace)
        self._keep(transformation)

    def _admit(self, transformation: Transformation, replace: bool) -> None:
        """Whether it may be registered; raises as `register` does."""
        name = transformation.name
        known = self._transformations.get(name)
        if known == transformation:
            return
        if known is None:
            self._check_name(name)
        elif not replace:
            raise AlreadyExists(
                f"there is a transformation called {name!r}", "replace it with PUT, or remove it"
            )
        self._check(transformation)

    def _keep(self, transformation: Transformation) -> None:
        name = transformation.name
        if self._transformations.get(name) != transformation:
            self._ontology.registered.transformations[name] = _json_of(transformation)
            self._put(transformation)

    def check(self, annotation: TransformationAnnotation | SourceAnnotation) -> None:
        """Whether the transformation may be annotated so; raises as `register` does."""
        self._check(self._annotated(annotation))

    def annotate(self, annotation: TransformationAnnotation | SourceAnnotation) -> None:
        """Say of a transformation what it takes and gives. One that nobody registered is
        registered with the implementation of its name. Contract: `check` has passed."""
        known = self._annotated(annotation)
        if annotation.name in self._ontology.registered.transformations:
            self._ontology.registered.transformations[annotation.name] = _json_of(known)
        else:
            self._ontology.registered.annotations[annotation.name] = annotation.source
        self._put(known)

    def change(
        self, name: str, *, cost: float | None = None, quality: float | None = None
    ) -> Transformation:
        """The cost or quality of a transformation has changed; raises `UnknownTransformation`
        and `BadArguments`."""
        known = self.get(name)
        changed = replace(
            known,
            cost=known.cost if cost is None else cost,
            quality=known.quality if quality is None else quality,
        )
        if changed != known:
            self._check(changed)
            self._ontology.registered.transformations[name] = _json_of(changed)
            self._put(changed, ChangeKind.QUALITY_CHANGED)
        return changed

    def remove(self, name: str) -> None:
        """Forget a transformation; raises `UnknownTransformation`, and `Conflict` while a unit of
        it runs or where it comes with the system."""
        self.get(name)
        if name in LIBRARY_NAMES:
            raise Conflict(f"transformation {name!r} comes with the system", "")
        units = self.view(name).units
        if units:
            raise Conflict(
                f"transformation {name!r} is used by {', '.join(units)}",
                "cancel the requests and subscriptions that need it first",
            )
        self._ontology.registered.transformations.pop(name, None)
        self._ontology.registered.annotations.pop(name, None)
        self._transformations.discard(name)
        self._changed(Change(ChangeKind.TRANSFORMATION_REMOVED, transformation=name))

    def tell_all(self) -> None:
        """Tell of those that come with the system."""
        for known in self._transformations.values():
            self._tell(known, ChangeKind.TRANSFORMATION_ANNOTATED)

    def restore(self) -> None:
        """The transformations that an earlier run was told of. One whose code is gone is there and
        cannot be used; what cannot be read is told on the status stream and left out."""
        for name, text in [*self._ontology.registered.transformations.items()]:
            try:
                known = _of_json(name, text)
            except (KeyError, TypeError, ValueError) as error:
                reason = f"{type(error).__name__}: {error}\n{text}"
                self._changed(
                    Change(ChangeKind.NOT_RESTORED, transformation=name, specification=reason)
                )
                continue
            self._put(known)
            lacks = self._transformations.describe(known).lacks
            if lacks:
                self._changed(
                    Change(ChangeKind.NOT_RESTORED, transformation=name, specification=lacks)
                )

    def _annotated(self, annotation: TransformationAnnotation | SourceAnnotation) -> Transformation:
        known = self._transformations.get(annotation.name)
        if known is None:
            return Transformation(annotation, annotation.name)
        return replace(known, annotation=annotation)

    def _check(self, transformation: Transformation) -> None:
        if not (math.isfinite(transformation.cost) and transformation.cost >= 0):
            raise BadArguments(f"a cost is a number, 0 or more, not {transformation.cost}")
        check_quality(transformation.quality)
        if isinstance(transformation.annotation, TransformationAnnotation):
            check_inputs(len(transformation.annotation.inputs))
        self._transformations.check(transformation)

    def _put(
        self,
        transformation: Transformation,
        kind: ChangeKind = ChangeKind.TRANSFORMATION_ANNOTATED,
    ) -> None:
        self._transformations.put(transformation)
        self._tell(transformation, kind)

    def _tell(self, known: Transformation, kind: ChangeKind) -> None:
        description = self._transformations.describe(known)
        parameters = known.parameters
        if not description.lacks:
            parameters = self._transformations.parameters_of(known)
        self._changed(
            Change(
                kind,
                transformation=known.name,
                specification=known.annotation.source,
                described=KnownTransformation(
                    description, known.implementation, tuple(sorted(parameters.items()))
                ),
            )
        )


def check_quality(quality: float) -> None:
    """Raises `BadArguments` for what is no quality."""
    if not 0 <= quality <= 1:
        raise BadArguments(f"a quality is a number from 0 to 1, not {quality}")


# -- what is kept ----------------------------------------------------------------------------


def _json_of(known: Transformation) -> str:
    annotation = known.annotation
    inputs = annotation.inputs if isinstance(annotation, TransformationAnnotation) else None
    return json.dumps(
        {
            "inputs": None if inputs is None else [_port_json(port) for port in inputs],
            "output": _port_json(annotation.output),
            "source": annotation.source,
            "implementation": known.implementation,
            "parameters": dict(known.parameters),
            "cost": known.cost,
            "quality": known.quality,
        }
    )


def _of_json(name: str, text: str) -> Transformation:
    kept = json.loads(text)
    output = _port_of(kept["output"])
    annotation: TransformationAnnotation | SourceAnnotation
    if kept["inputs"] is None:
        annotation = SourceAnnotation(name, output, kept["source"])
    else:
        inputs = tuple(_port_of(port) for port in kept["inputs"])
        annotation = TransformationAnnotation(name, inputs, output, kept["source"])
    return Transformation(
        annotation, kept["implementation"], kept["parameters"], kept["cost"], kept["quality"]
    )


def _port_json(port: PortAnnotation) -> dict[str, object]:
    return {
        "field": port.field,
        "feature": port.feature,
        "unit": format_unit(port.unit),
        "arguments": [
            [argument.variable, argument.sort, argument.object, argument.id_field]
            for argument in port.arguments
        ],
    }


def _port_of(kept: Mapping[str, object]) -> PortAnnotation:
    arguments = kept["arguments"]
    assert isinstance(arguments, list)
    return PortAnnotation(
        str(kept["field"]),
        str(kept["feature"]),
        parse_unit(str(kept["unit"])),
        tuple(Argument(*argument) for argument in arguments),
    )
