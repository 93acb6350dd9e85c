"""Golden cases: ``tests/cases/<language>/*.case`` (title, input, ``----``, expected printout).

``DYKNOW_REWRITE=1 pytest tests/languages/test_cases.py`` writes the printouts anew.
"""

import json
import os
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path

import pytest
from places import TESTS
from vocabularies import vocabulary_of

from dyknow.languages.chronicle import (
    check_chronicle,
    check_chronicle_template,
    format_chronicle,
    format_chronicle_template,
    parse_chronicle,
    parse_chronicle_template,
)
from dyknow.languages.chronicle.checked import Message
from dyknow.languages.csparql import (
    ContinuousQuery,
    bind,
    body_sparql,
    format_query,
    parse_event_request,
    parse_query,
    parse_template,
)
from dyknow.languages.epsparql import format_epsparql, parse_epsparql
from dyknow.languages.errors import LanguageError
from dyknow.languages.kpl import ValueSort, check_kpl, format_kpl, parse_kpl
from dyknow.languages.mtl import (
    check_formula_template,
    check_mtl,
    format_formula_template,
    format_monitor,
    is_formula_template,
    is_monitor,
    parse_formula_template,
    parse_monitor,
)
from dyknow.languages.mtl.checked import Constant, Kind, ObjectConstant, Parameter, Reading
from dyknow.languages.sase import (
    bound_sase,
    check_sase,
    check_sase_template,
    format_sase,
    format_sase_template,
    parse_sase,
    parse_sase_template,
)
from dyknow.languages.sase.checked import ValueSlot
from dyknow.languages.specification import (
    format_specification,
    parse_specification,
)
from dyknow.languages.ssl import (
    CheckedAnnotation,
    StreamAnnotation,
    TransformationAnnotation,
    check_ssl,
    format_declaration,
    parse_ssl,
)
from dyknow.ontology.units import format_unit
from dyknow.rdf.namespaces import DYKNOW, shorten
from dyknow.reasoning.patterns.compilation.sase_plans import sase_query
from dyknow.reasoning.patterns.compilation.sase_sources import sase_sources
from dyknow.reasoning.patterns.plans.printer import print_plan
from dyknow.reasoning.patterns.plans.query import Source

CASES = TESTS / "cases"

ONTOLOGY = """
dyknow:Thing a owl:Class .
dyknow:UAV a owl:Class ; rdfs:subClassOf dyknow:Thing .
dyknow:RMAX a owl:Class ; rdfs:subClassOf dyknow:UAV , dyknow:Thing .
dyknow:uav1 a dyknow:UAV , dyknow:Thing .
dyknow:altitude a dyknow-o:Feature ; dyknow-o:hasUnit "ft" .
dyknow:speed a dyknow-o:Feature , dyknow-o:UnaryFeature .
dyknow:speed dyknow-o:hasUnit "km.h-1" ; rdfs:range xsd:double .
dyknow:xydist a dyknow-o:Feature .
dyknow:distance a dyknow-o:Feature ; dyknow-o:hasArity 2 .
dyknow:course a dyknow-o:Feature ; dyknow-o:hasUnit "deg" .
dyknow:onGround a dyknow-o:Feature , dyknow-o:UnaryFeature ; rdfs:range xsd:boolean .
dyknow:callsign a dyknow-o:Feature , dyknow-o:UnaryFeature ; rdfs:range xsd:string .
dyknow:owner a dyknow-o:Feature .
dyknow:behind a dyknow-o:Feature ; dyknow-o:hasArity 2 ; rdfs:range xsd:boolean .
dyknow:beside a dyknow-o:Feature ; dyknow-o:hasArity 2 ; rdfs:range xsd:boolean .
dyknow:inFront a dyknow-o:Feature ; dyknow-o:hasArity 2 ; rdfs:range xsd:boolean .
dyknow:stopped a dyknow-o:Event .
dyknow:HighSpeedEvent a dyknow-o:Event .
"""
VOCABULARY = vocabulary_of(ONTOLOGY)


def print_ssl(text: str) -> str:
    declarations = parse_ssl(text)
    annotations = check_ssl(declarations, text, VOCABULARY)
    lines = []
    for declaration, annotation in zip(declarations, annotations, strict=True):
        lines += [format_declaration(declaration), *print_annotation(annotation)]
    return "\n".join(lines)


def print_annotation(annotation: CheckedAnnotation) -> list[str]:
    if isinstance(annotation, StreamAnnotation):
        return [
            f"  {shorten(c.feature)} in {c.field} [{format_unit(c.unit)}] of "
            + (", ".join(print_role(r.sort, r.object, r.id_field) for r in c.roles) or "nothing")
            for c in annotation.contents
        ]
    ports = annotation.inputs if isinstance(annotation, TransformationAnnotation) else ()
    named = [("input", port) for port in ports] + [("output", annotation.output)]
    return [
        f"  {kind} {shorten(port.feature)} in {port.field} [{format_unit(port.unit)}]"
        for kind, port in named
    ]


def print_role(sort: str | None, object: str | None, id_field: str | None) -> str:
    what = f"every {shorten(sort)}" if sort is not None else shorten(object or "")
    return what if id_field is None else f"{what} named by {id_field}"


def print_csparql(text: str) -> str:
    """A query or template; after it, from ``==`` on, an event request whose arguments are bound."""
    text, _, request = text.partition("==\n")
    if text.lstrip().startswith("dyknow:"):
        parsed = parse_event_request(text)
        return "\n".join([shorten(parsed.event), *map(str, parsed.arguments)])
    if "TEMPLATE" not in text:
        return print_query(parse_query(text))
    template = parse_template(text)
    names = ", ".join(map(str, template.parameters))
    query = template.query
    if request:
        arguments = zip(template.parameters, parse_event_request(request).arguments, strict=True)
        query = bind(query, {p: a for p, a in arguments if str(a)[0] != "?"})
    return f"{shorten(template.name)}({names})\n{print_query(query)}"


def print_query(query: ContinuousQuery) -> str:
    printed = format_query(query)
    # What is printed can be read, and is printed the same again.
    assert format_query(parse_query(printed)) == printed
    return f"{printed}-> SPARQL\n{body_sparql(query)}".rstrip()


def print_kpl(text: str) -> str:
    """The declarations, each with the sort that it gives."""
    new, _ = check_kpl(parse_kpl(text), text, VOCABULARY)
    printed = format_kpl(new)
    # What is printed says the same.
    assert check_kpl(parse_kpl(printed), printed, VOCABULARY)[0] == new
    sorts = [print_sort(declaration.sort) for declaration in new]
    return "\n".join(f"{format_kpl(d)}\n  {sort}" for d, sort in zip(new, sorts, strict=True))


def print_sort(sort: ValueSort) -> str:
    if sort.fields is None:
        return f"{sort.name}, open"
    feature = f" of {shorten(sort.feature)}" if sort.feature else ""
    return f"{sort.name}: {', '.join(f'{f.name} {f.type}' for f in sort.fields)}{feature}"


def print_specification(text: str) -> str:
    specification = parse_specification(text)
    printed = format_specification(specification)
    # What is printed says the same.
    assert parse_specification(printed) == specification
    return printed


def print_epsparql(text: str) -> str:
    query = parse_epsparql(text)
    printed = format_epsparql(query)
    # What is printed says the same.
    assert parse_epsparql(printed) == query
    return printed


def print_mtl(text: str) -> str:
    """The monitor or template as it is printed, then its parameters and the feature values that it
    reads."""
    # What is printed says the same.
    if "TEMPLATE" in text.upper():
        template = parse_formula_template(text)
        printed = format_formula_template(template)
        assert parse_formula_template(printed) == template
        found = check_formula_template(template, VOCABULARY)
        lines = [
            f"  ?{slot.name}: {slot.kind}"
            if isinstance(slot, Parameter)
            else f"  ?{slot.name} in {shorten(slot.sort)}"
            for slot in found.slots
        ]
        checked = found.monitor
    else:
        monitor = parse_monitor(text)
        printed = format_monitor(monitor)
        assert parse_monitor(printed) == monitor
        checked = check_mtl(monitor, text, VOCABULARY)
        lines = [f"  ?{variable} in {shorten(sort)}" for variable, sort in checked.parameters]
    for each in dict.fromkeys(readings(checked.formula)):
        names = ", ".join(
            shorten(argument.iri) if hasattr(argument, "iri") else f"?{argument.name}"
            for argument in each.arguments
        )
        unit = "" if each.unit is None else f" [{format_unit(each.unit)}]"
        lines.append(f"  {shorten(each.feature)}({names}): {each.kind}{unit}")
    return "\n".join([printed, *lines])


def print_chronicle(text: str) -> str:
    """The chronicle or template as it is printed, then its variables and what it reads."""
    # What is printed says the same.
    lines = []
    if "TEMPLATE" in text.upper():
        template = parse_chronicle_template(text)
        printed = format_chronicle_template(template)
        assert parse_chronicle_template(printed) == template
        found = check_chronicle_template(template, VOCABULARY)
        checked = found.chronicle
        lines += [f"  ?{s.name}: {s.kind}" for s in found.slots if isinstance(s, Parameter)]
    else:
        chronicle = parse_chronicle(text)
        printed = format_chronicle(chronicle)
        assert parse_chronicle(printed) == chronicle
        checked = check_chronicle(chronicle, text, VOCABULARY)
    for name, meaning in checked.variables.items():
        unit = "" if meaning.unit is None else f" [{format_unit(meaning.unit)}]"
        sort = "" if meaning.sort is None else f" in {shorten(meaning.sort)}"
        lines.append(f"  ?{name}: {meaning.kind}{sort}{unit}")
    return "\n".join([printed, *lines, *map(print_message, checked.messages())])


def print_message(message: Message) -> str:
    names = ", ".join(
        "?" if each is None else shorten(each.iri) if hasattr(each, "iri") else f"?{each.name}"
        for each in message.arguments
    )
    tests = [
        f"  {word} {test.operator} {test.operand}"
        for word, test in (("before", message.before), ("value", message.value))
        if test is not None
    ]
    kind = "" if message.kind is None else f": {message.kind}"
    return "\n".join([f"  {shorten(message.concept)}[{names}]{kind}", *("  " + t for t in tests)])


def readings(node: object) -> Iterator[Reading]:
    """The feature values in a checked formula, in order."""
    if isinstance(node, Reading):
        yield node
    elif is_dataclass(node):
        for field in fields(node):
            yield from readings(getattr(node, field.name))


FIELDS = {
    **dict.fromkeys(("tag", "gate"), Kind.TEXT),
    **dict.fromkeys(("price", "volume"), Kind.NUMBER),
    "at": Kind.TIME,
}
"""The fields that each stream has for SASE+ patterns."""


def print_sase(text: str) -> str:
    """The pattern or template as it is printed; then its parameters, sources and plan."""
    if "TEMPLATE" in text.upper():
        text, _, request = text.partition("==\n")
        template = parse_sase_template(text)
        printed = format_sase_template(template)
        assert parse_sase_template(printed) == template
        found = check_sase_template(template, VOCABULARY)
        lines = [
            f"?{s.name}: {s.kind or 'any'}"
            if isinstance(s, ValueSlot)
            else f"?{s.name} in {shorten(s.sort)}"
            for s in found.slots
        ]
        given = dict(zip((s.name for s in found.slots), json.loads(request or "[]"), strict=False))
        arguments = {
            name: ObjectConstant(DYKNOW + value)
            if isinstance(value, str)
            else Constant(float(value), Kind.NUMBER)
            for name, value in given.items()
            if value is not None
        }
        if not request:
            return "\n".join([printed, *(f"  {line}" for line in lines)])
        checked = bound_sase(found, arguments)
    else:
        pattern = parse_sase(text)
        printed = format_sase(pattern)
        assert parse_sase(printed) == pattern
        checked, lines = check_sase(pattern, text, VOCABULARY), []
    kinds = {(s.kind, field): FIELDS[field] for s in sase_sources(checked) for field in FIELDS}
    query = sase_query(checked, kinds)
    lines += [print_source(source) for source in query.sources]
    lines += print_plan(query.plans[0]).splitlines()
    lines += [f"result {each.name}: {each.kind}" for each in query.results]
    return "\n".join([printed, *(f"  {line}" for line in lines)])


def print_source(source: Source) -> str:
    of = ", ".join(print_role(each.sort, each.object, None) for each in source.arguments)
    columns = ", ".join(f"{each.column} = {each.part}" for each in source.columns)
    read = f" in {source.stream}" if source.stream else ""
    return f"source {source.kind} of {of}{read}: {columns}"


PRINTERS = {
    "chronicle": print_chronicle,
    "mtl": print_mtl,
    "sase": print_sase,
    "ssl": print_ssl,
    "csparql": print_csparql,
    "epsparql": print_epsparql,
    "kpl": print_kpl,
    "specification": print_specification,
}


@pytest.mark.parametrize(
    "path",
    [path for language in PRINTERS for path in sorted(CASES.glob(f"{language}/*.case"))],
    ids=lambda path: f"{path.parent.name}-{path.stem}",
)
def test_case(path: Path) -> None:
    title, _, rest = path.read_text(encoding="utf-8").partition("\n")
    text, _, expected = rest.partition("----\n")
    try:
        printed = PRINTERS[path.parent.name](text.rstrip("\n"))
    except LanguageError as error:
        printed = f"error: {error.render()}"
    printed = "\n".join(line.rstrip() for line in printed.splitlines())
    if os.environ.get("DYKNOW_REWRITE") == "1":
        path.write_text(f"{title}\n{text}----\n{printed}\n", encoding="utf-8")
        return
    assert printed == expected.rstrip("\n"), title


def test_every_case_file_is_of_a_known_language() -> None:
    for language in PRINTERS:
        assert list(CASES.glob(f"{language}/*.case"))


@pytest.mark.parametrize(
    ("text", "is_formula"),
    [
        ("REGISTER TEMPLATE dyknow:R(?x in Car) AS (speed(?x) > 3)", True),
        ("# a\nregister template R(?x, ?y)\nas # b\n speed(?x) > ?y", True),
        ("REGISTER TEMPLATE R(?x) AS <http://example.org/f>(?x)", True),
        ("REGISTER TEMPLATE R() AS wind > 3", True),
        ("REGISTER TEMPLATE R(?x) COMPUTE EVERY 1s AS SELECT", False),
        ("REGISTER TEMPLATE R(?x) AS PREFIX a: <b>", False),
        ("REGISTER TEMPLATE R(?x) AS select (?x as", False),
        ("REGISTER TEMPLATE R(?x) AS CONSTRUCT{", False),
        ("REGISTER TEMPLATE R(?x) AS chronicle (", False),
        # A comment matches in one way: otherwise these texts would not end.
        ("#" * 40_000 + "\nx", False),
        ("register template R(?x) as" + "\n#" * 20_000 + "a" * 20_000, False),
        ("register template R" + "(" * 40_000, False),
    ],
)
def test_what_follows_as_tells_the_language(text: str, is_formula: bool) -> None:
    assert is_formula_template(text) is is_formula
    assert not is_monitor(text)
