"""A first SSL text for a recorded stream: known features by the names of fields, others to fill in.

The text is valid SSL as it stands. A field becomes a feature if the ontology has a feature of its
name (case and ``_`` aside) whose range fits the field's type, and in the unit that the ontology
states. The sort is that of these features, if they have one. Other fields are comments, which
become declarations when the ``#`` is taken away: of the feature of the field's name, which the
ontology has to know by then.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from ....converters.recordings.overview import Overview
from ....languages.ssl.annotation_text import term_words
from ....languages.ssl.printer import field_words
from ....ontology.units import format_unit
from ....ontology.vocabulary import THING, FeatureInfo, Vocabulary
from ....rdf.namespaces import XSD, local_name
from ....streams.sample import Field, FieldType

SORT: Final = "Thing"
OBJECT: Final = "object1"
_RANGES: Final = {XSD + "string": {FieldType.STRING}, XSD + "boolean": {FieldType.BOOLEAN}}
_NUMBERS: Final = {FieldType.FLOAT, FieldType.INTEGER}


def known_features(overview: Overview, vocabulary: Vocabulary) -> dict[str, str]:
    """The feature (its IRI) of each field that has the name of one."""
    by_name = {_key(local_name(iri)): iri for iri in reversed(vocabulary.features())}
    found: dict[str, str] = {}
    for field in overview.schema.fields:
        info = vocabulary.feature(by_name.get(_key(field.name), ""))
        is_new = info is not None and info.iri not in found.values()
        if info is not None and is_new and field.name != overview.id_field and _fits(info, field):
            found[field.name] = info.iri
    return found


def ssl_skeleton(name: str, overview: Overview, vocabulary: Vocabulary) -> str:
    """The SSL text of stream ``name``, with comments that say what is left to do."""
    known = known_features(overview, vocabulary)
    sort = _sort_of(known.values(), vocabulary)
    whose = OBJECT if overview.id_field is None else sort
    others = [f for f in overview.schema.fields if f.name not in {*known, overview.id_field}]
    lines = [f"# Put the name of the object in place of {OBJECT}."]
    after = []
    if overview.id_field is not None:
        lines = ["# Check the units."]
        if sort == SORT:
            lines = [f"# Put the sort of the objects in place of {SORT}, and check the units."]
        after = [f"for every {sort} = {field_words(overview.id_field)}"]
    if others:
        add = "#   dyknow ontology add-feature NAME"
        lines += ["# To use a field that is a comment, add its feature to the ontology:"]
        lines += [f"{add} {option} --sort {sort}" for option in _options(others)]
    unknown = [f"{_new_name(field)}({whose}) = {field_words(field.name)}" for field in others]
    features = [_declared(field, iri, whose, vocabulary) for field, iri in known.items()]
    if features:
        lines += [f"stream {name} contains", "  " + ",\n  ".join(features)]
        lines += [f"  # , {declared}" for declared in unknown]
        return "\n".join([*lines, *after])
    marks = [" ", *[","] * len(others)]
    lines += [f"# stream {name} contains"]
    lines += [f"#   {mark} {each}" for mark, each in zip(marks, unknown, strict=False)]
    return "\n".join([*lines, *(f"# {line}" for line in after)])


def _sort_of(features: Iterable[str], vocabulary: Vocabulary) -> str:
    """The one sort that all these features are stated for; `SORT` if there is none."""
    infos = (vocabulary.feature(iri) for iri in features)
    domains = {None if info is None else info.domain for info in infos}
    (found,) = domains if len(domains) == 1 else (None,)
    return SORT if found in (None, THING) else term_words(found)


def _options(fields: list[Field]) -> list[str]:
    """The options of new features: numbers have a unit, texts and truth values a range."""
    kinds = {field.type for field in fields}
    ranges = [f"--range xsd:{local_name(each)}" for each, types in _RANGES.items() if kinds & types]
    are_all_ranges = kinds <= frozenset().union(*_RANGES.values())
    return ranges if are_all_ranges else ["--unit UNIT", *ranges]


def _new_name(field: Field) -> str:
    """The field's name if a feature may have it as it is."""
    return field.name if field_words(field.name) == field.name else "FEATURE"


def _declared(field: str, iri: str, whose: str, vocabulary: Vocabulary) -> str:
    info = vocabulary.feature(iri)
    unit = f" [{format_unit(info.unit)}]" if info is not None and info.unit else ""
    return f"{term_words(iri)}({whose}) = {field_words(field)}{unit}"


def _fits(info: FeatureInfo, field: Field) -> bool:
    """Whether a value of the field can be one of the feature."""
    if info.arity not in (None, 1):
        return False
    if info.unit:
        return field.type in _NUMBERS
    if info.range is None or not info.range.startswith(XSD):
        return True
    return field.type in _RANGES.get(info.range, _NUMBERS)


def _key(name: str) -> str:
    return name.replace("_", "").lower()
