"""Transformations that users register and annotate ([Introspection15 §3.1, §4.2]).

A registration has the annotation of inputs and output, the implementation with its parameters, and
the cost and quality. The ontology keeps it over a restart.
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
from ...matching.plan_text import transformation_text
from ...matching.space import TransformationDescription
from ...ontology.ontology import Ontology
from ...ontology.units import format_unit, parse_unit
from ..configuration.configuration import Configuration
from ..model.errors import (
    AlreadyExists,
    BadArguments,
    Conflict,
    UnknownFeature,
    UnknownTransformation,
)
from ..model.status_changes import Change, ChangeKind, KnownTransformation
from .iri_annotations import DescribedTransformation, Describer, check_inputs
from .transformation_library import LIBRARY_NAMES, Transformation, Transformations


@dataclass(frozen=True, slots=True)
class TransformationView:
    """A transformation as the service shows it; ``lacks`` is the reason why the system cannot make
    units of it, or empty."""

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
    """Registers, annotates and removes transformations, and reports each change. Changes that the
    ontology should mirror in one write are made within ``together``."""

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
        """Return all transformations, in the order of registration."""
        return self._views(self._transformations)

    def view(self, name: str) -> TransformationView:
        """Return one transformation. Raises `UnknownTransformation`."""
        units = self._configuration.units.values()
        return self._view(name, [unit.name for unit in units if unit.transformation == name])

    def _views(self, names: Iterable[str]) -> tuple[TransformationView, ...]:
        # One pass over all units, rather than one for each transformation.
        units: dict[str, list[str]] = {}
        for unit in self._configuration.units.values():
            units.setdefault(unit.transformation, []).append(unit.name)
        return tuple(self._view(name, units.get(name, ())) for name in names)

    def _view(self, name: str, units: Sequence[str]) -> TransformationView:
        transformation = self.get(name)
        description, parameters = self._describe(transformation)
        return TransformationView(
            name=transformation.name,
            text=transformation_text(description),
            annotation=transformation.annotation,
            implementation=transformation.implementation,
            parameters=dict(parameters),
            cost=transformation.cost,
            quality=transformation.quality,
            lacks=description.lacks,
            units=tuple(units),
        )

    def _describe(
        self, transformation: Transformation
    ) -> tuple[TransformationDescription, Mapping[str, str]]:
        """Return the description for matching, and the parameters: with the defaults, if the
        implementation, which has them, exists."""
        description = self._transformations.describe(transformation)
        if description.lacks:
            return description, transformation.parameters
        return description, self._transformations.parameters_of(transformation)

    def get(self, name: str) -> Transformation:
        """Return a transformation by name. Raises `UnknownTransformation`."""
        found = self._transformations.get(name)
        if found is None:
            names = ", ".join(self._transformations)
            raise UnknownTransformation(
                f"there is no transformation called {name!r}", f"there are: {names}"
            )
        return found

    def register_described(
        self, described: DescribedTransformation, *, replace: bool = False
    ) -> TransformationView:
        """Register a described transformation; see `register`."""
        (view,) = self.register_all([described], replace=replace)
        return view

    def register_all(
        self, described: Sequence[DescribedTransformation], *, replace: bool = False
    ) -> tuple[TransformationView, ...]:
        """Register described transformations, all of them or none; see `register`."""
        describer = Describer(self._ontology.vocabulary)
        transformations = [describer.transformation(each) for each in described]
        names = [each.name for each in transformations]
        for name, number in Counter(names).items():
            if number > 1:
                raise BadArguments(f"{name!r} is described twice", "give each its own name")
        for each in transformations:
            self._check_registration(each, replace)
        with self._together():
            for each in transformations:
                self._store(each)
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
        """Register the source or unit that an SSL text annotates; see `register`. Raises
        `LanguageError`, and `BadArguments` if the text annotates anything else."""
        checked = check_ssl(parse_ssl(ssl), ssl, self._ontology.vocabulary)
        annotation = checked[0] if len(checked) == 1 else None
        if annotation is None or isinstance(annotation, StreamAnnotation):
            raise BadArguments(
                "the annotation of a transformation is one declaration",
                "write `compunit NAME transforms … to …`, or `source NAME provides …`",
            )
        code = implementation or annotation.name
        transformation = Transformation(annotation, code, dict(parameters or {}), cost, quality)
        self.register(transformation, replace=replace)
        return self.view(transformation.name)

    def register(self, transformation: Transformation, *, replace: bool = False) -> None:
        """Register a transformation; matching uses it from now on.

        Raises `AlreadyExists` unless ``replace``, and `Refused` for a name of the system. Raises
        `BadArguments`, `Conflict` or `UnknownFeature` if annotation, code and parameters do not fit
        together. Running units stay as they are.
        """
        self._check_registration(transformation, replace)
        self._store(transformation)

    def _check_registration(self, transformation: Transformation, replace: bool) -> None:
        """Raise the errors of `register`."""
        name = transformation.name
        existing = self._transformations.get(name)
        if existing == transformation:
            return
        if existing is None:
            self._check_name(name)
        elif not replace:
            raise AlreadyExists(
                f"there is a transformation called {name!r}", "replace it with PUT, or remove it"
            )
        self._check(transformation)

    def _store(self, transformation: Transformation) -> None:
        name = transformation.name
        if self._transformations.get(name) != transformation:
            self._ontology.registered.transformations[name] = _json_of(transformation)
            self._put(transformation)

    def check(self, annotation: TransformationAnnotation | SourceAnnotation) -> None:
        """Check that the transformation may have this annotation. Raises the errors of
        `register`."""
        try:
            self._check(self._annotated(annotation))
        except UnknownFeature as error:
            if annotation.name in self._transformations:
                raise
            raise UnknownFeature(
                error.detail,
                "code of another name: send the annotation with `implementation` and `parameters` "
                f"to POST /transformations, as GET /transformations shows them; {error.hint}",
            ) from error

    def annotate(self, annotation: TransformationAnnotation | SourceAnnotation) -> None:
        """Annotate a transformation. If none is registered, register one with the implementation
        of the same name. Contract: `check` has passed."""
        transformation = self._annotated(annotation)
        if annotation.name in self._ontology.registered.transformations:
            self._ontology.registered.transformations[annotation.name] = _json_of(transformation)
        else:
            self._ontology.registered.annotations[annotation.name] = annotation.source
        self._put(transformation)

    def change(
        self, name: str, *, cost: float | None = None, quality: float | None = None
    ) -> Transformation:
        """Change the cost or quality of a transformation. Raises `UnknownTransformation` and
        `BadArguments`."""
        existing = self.get(name)
        changed = replace(
            existing,
            cost=existing.cost if cost is None else cost,
            quality=existing.quality if quality is None else quality,
        )
        if changed != existing:
            self._check(changed)
            self._ontology.registered.transformations[name] = _json_of(changed)
            self._put(changed, ChangeKind.QUALITY_CHANGED)
        return changed

    def remove(self, name: str) -> None:
        """Remove a transformation. Raises `UnknownTransformation`, and `Conflict` while a unit of
        it runs or if it is built in."""
        self.get(name)
        if name in LIBRARY_NAMES:
            raise Conflict(f"transformation {name!r} is built in, so it cannot be removed", "")
        units = self.view(name).units
        if units:
            raise Conflict(
                f"transformation {name!r} has units: {', '.join(units)}",
                "cancel the requests and subscriptions that need it first",
            )
        self._ontology.registered.transformations.pop(name, None)
        self._ontology.registered.annotations.pop(name, None)
        self._transformations.discard(name)
        self._changed(Change(ChangeKind.TRANSFORMATION_REMOVED, transformation=name))

    def report_all(self) -> None:
        """Report the transformations that exist: at the start, the built-in ones."""
        for transformation in self._transformations.values():
            self._report(transformation, ChangeKind.TRANSFORMATION_ANNOTATED)

    def restore(self) -> None:
        """Restore the registered transformations of an earlier run. One whose code is missing
        exists but has no units. The status stream reports both these and unreadable texts."""
        for name, text in [*self._ontology.registered.transformations.items()]:
            try:
                transformation = _of_json(name, text)
            except (KeyError, TypeError, ValueError) as error:
                reason = f"{type(error).__name__}: {error}\n{text}"
                self._changed(
                    Change(ChangeKind.NOT_RESTORED, transformation=name, specification=reason)
                )
                continue
            self._put(transformation)
            lacks = self._transformations.describe(transformation).lacks
            if lacks:
                self._changed(
                    Change(ChangeKind.NOT_RESTORED, transformation=name, specification=lacks)
                )

    def _annotated(self, annotation: TransformationAnnotation | SourceAnnotation) -> Transformation:
        existing = self._transformations.get(annotation.name)
        if existing is None:
            return Transformation(annotation, annotation.name)
        return replace(existing, annotation=annotation)

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
        self._report(transformation, kind)

    def _report(self, transformation: Transformation, kind: ChangeKind) -> None:
        description, parameters = self._describe(transformation)
        self._changed(
            Change(
                kind,
                transformation=transformation.name,
                specification=transformation.annotation.source,
                described=KnownTransformation(
                    description, transformation.implementation, tuple(sorted(parameters.items()))
                ),
            )
        )


def check_quality(quality: float) -> None:
    """Raise `BadArguments` unless ``quality`` is in [0, 1]."""
    if not 0 <= quality <= 1:
        raise BadArguments(f"a quality is a number from 0 to 1, not {quality}")


# -- the registered text ---------------------------------------------------------------------


def _json_of(transformation: Transformation) -> str:
    annotation = transformation.annotation
    inputs = annotation.inputs if isinstance(annotation, TransformationAnnotation) else None
    return json.dumps(
        {
            "inputs": None if inputs is None else [_port_json(port) for port in inputs],
            "output": _port_json(annotation.output),
            "source": annotation.source,
            "implementation": transformation.implementation,
            "parameters": dict(transformation.parameters),
            "cost": transformation.cost,
            "quality": transformation.quality,
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
