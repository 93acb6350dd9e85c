"""The plain SPARQL 1.1 of a continuous query: what Oxigraph runs per window ([Events14 §III.A]).

All of it is done by edits at offsets of the user's text, so what is not touched stays as written:

- AGGREGATE becomes a sub-select with GROUP BY and HAVING (`SPEC §5`);
- an alias in HAVING becomes its aggregate: both engines know no alias there and answer nothing;
- a bound parameter is a VALUES row inside each group that uses it (a group does not see the
  bindings around it), and a group key, so that HAVING sees it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

from pyoxigraph import BlankNode, Variable

from ...rdf.dictionary import Term
from ...rdf.namespaces import PREFIXES
from ..errors import Span
from ..remembered import remembered
from .ast import Aggregation, ContinuousQuery, StreamClause
from .shape import Group, Shape, groups, query_shape
from .syntax import translated
from .terms import term_text
from .tokens import Kind, Token, compact, tokenize

if TYPE_CHECKING:
    from rdflib.plugins.sparql.sparql import Query


@dataclass(frozen=True, slots=True)
class Edit:
    """Replace ``text[start:end]``; an insertion where both are equal."""

    start: int
    end: int
    text: str


def apply_edits(text: str, edits: Sequence[Edit]) -> str:
    """The text with disjoint edits made. Insertions at one place keep their order."""
    parts: list[str] = []
    position = 0
    for edit in sorted(edits, key=lambda edit: (edit.start, edit.end)):
        parts.append(text[position : edit.start])
        parts.append(edit.text)
        position = edit.end
    parts.append(text[position:])
    return "".join(parts)


def bind(query: ContinuousQuery, arguments: Mapping[Variable, Term]) -> ContinuousQuery:
    """The query with template arguments given: recorded as terms, never pasted as text.

    Meaning: a join with the row of parameters. Raises `ValueError` for a variable that the query
    does not use and for a blank node, which names nothing outside its own text.
    """
    known = {t.text[1:] for t in tokenize(query.sparql) if t.kind is Kind.VARIABLE}
    known |= {name for text, _ in query.aggregate_filters for name in _variables(tokenize(text))}
    for variable, term in arguments.items():
        if variable.value not in known:
            raise ValueError(f"the query does not use {variable}")
        if isinstance(term, BlankNode):
            raise ValueError(f"{variable} is given a blank node, which names nothing here")
    return replace(query, bindings={**query.bindings, **arguments})


def with_streams(query: ContinuousQuery, streams: Sequence[str]) -> ContinuousQuery:
    """The query reading these streams (IRIs or names) through its WINDOW ([Events14 §V.C]).

    A name becomes ``http://www.ida.liu.se/dyknow/NAME.trdf``. Raises `ValueError` if the query
    has neither a WINDOW clause nor a FROM STREAM clause to take the window from, and if it names
    windows: then each pattern says which stream it is about.
    """
    named = next((clause.name for clause in query.streams if clause.name is not None), None)
    if named is not None:
        raise ValueError(
            f"the query's streams cannot be replaced: it asks the window <{named}> by its name"
        )
    window = query.window or (query.streams[0].window if query.streams else None)
    if window is None:
        raise ValueError(f"{query.name or 'the query'} has no window")
    span = query.streams[0].span if query.streams else Span(0, 0)
    clauses = tuple(StreamClause(stream_iri(name), window, span) for name in streams)
    return replace(query, streams=clauses)


def stream_iri(name: str) -> str:
    """The IRI of a stream in FROM STREAM; an IRI is left as it is."""
    return name if ":" in name else f"{PREFIXES['dyknow']}{name}.trdf"


def group_keys(query: ContinuousQuery) -> tuple[Variable, ...]:
    """The group keys of an AGGREGATE query: the other head variables and every bound parameter.

    Empty for a query without AGGREGATE (SPARQL's GROUP BY says it, see `algebra`).
    """
    if not query.aggregations:
        return ()
    return tuple(map(Variable, _keys(query, _shape(query), [v.value for v in query.bindings])))


def nested_parameters(query: ContinuousQuery) -> frozenset[Variable]:
    """Bound parameters used in a nested group or sub-query of WHERE.

    There a join with the row of parameters at the top is not enough, since SPARQL evaluates a
    group without the bindings around it. `body_sparql` puts the row into the group itself.
    """
    shape = _shape(query)
    if not shape.has_where:
        return frozenset()
    inner = (g for g in groups_of(query.sparql) if g.open != shape.where_open)
    names = {name for group in inner for name in group.names}
    return frozenset(variable for variable in query.bindings if variable.value in names)


def body_sparql(query: ContinuousQuery) -> str:
    """The equivalent SPARQL 1.1 query, bindings as VALUES rows, FROM clauses taken away.

    Cost: one pass over the tokens, which are remembered per source.
    """
    rows = {v.value: term_text(term) for v, term in query.bindings.items()}
    return _body(query, rows, list(rows))


def algebra(query: ContinuousQuery) -> Query:
    """rdflib's algebra of the query without the values of its bindings.

    Bound parameters are free variables there and group keys where the query groups, so every
    instance of one template has the same algebra object. Do not change it.
    """
    return translated(bind_names(query, [variable.value for variable in query.bindings]))


def bind_names(query: ContinuousQuery, parameters: Sequence[str]) -> str:
    """`body_sparql` with these parameters bound to no value yet: group keys, no VALUES rows."""
    return _body(query, {}, parameters)


def _shape(query: ContinuousQuery) -> Shape:
    shape = query_shape(query.sparql)
    if shape is None:
        raise ValueError("the query has no WHERE; parse_query refuses such a text")
    return shape


def _body(query: ContinuousQuery, rows: Mapping[str, str], parameters: Sequence[str]) -> str:
    shape = _shape(query)
    edits: list[Edit] = []
    if shape.has_where:
        edits += values_edits(shape, groups_of(query.sparql), rows, parameters)
        if query.aggregations:
            # The sub-select encloses the VALUES row, so its edit comes first at that place.
            edits = [*_aggregate_edits(query, shape, parameters), *edits]
        else:
            edits += _grouping_edits(shape, parameters)
        for group in groups_of(query.sparql):
            if group.select is not None:
                edits += _alias_edits(group.select)
        edits += _alias_edits(shape)
        if shape.is_short_construct and rows:
            edits.append(template_edit(query.sparql, shape))
    return prefix_lines(query) + compact(apply_edits(query.sparql, edits)) + "\n"


def prefix_lines(query: ContinuousQuery) -> str:
    """PREFIX lines for shared prefixes that the query uses without declaring them."""
    declared = _declared(query.sparql)
    used = query.prefixes.items()
    return "".join(f"PREFIX {name}: <{iri}>\n" for name, iri in used if name not in declared)


@remembered
def groups_of(sparql: str) -> tuple[Group, ...]:
    """The groups of a query's text: asked for a dozen times while it is registered."""
    shape = query_shape(sparql)
    return () if shape is None else tuple(groups(shape.tokens, shape.where_open))


@remembered
def _declared(sparql: str) -> frozenset[str]:
    tokens = tokenize(sparql)
    return frozenset(
        name.text[:-1]
        for word, name in pairwise(tokens)
        if word.is_word("PREFIX") and name.kind is Kind.PREFIXED
    )


def values_edits(
    shape: Shape, found: Sequence[Group], rows: Mapping[str, str], parameters: Sequence[str]
) -> list[Edit]:
    """Insert a VALUES row into each group that uses a parameter, all of them into the first."""
    edits: list[Edit] = []
    tokens = shape.tokens
    sub_select: Sequence[str] = ()
    for group in found:
        if group.select is not None:
            # The row goes into the sub-query's own WHERE, which is the next group.
            sub_select = [name for name in parameters if name in group.names]
            edits += _grouping_edits(group.select, _uses(group.select, parameters))
            continue
        if group.open == shape.where_open:
            names = list(rows)
        else:
            # A filter directly in OPTIONAL sees what is around it; nowhere else it does.
            own = () if group.word == "OPTIONAL" else group.names
            names = [name for name in rows if name in own or name in sub_select]
        sub_select = ()
        if names:
            head = " ".join(f"?{name}" for name in names)
            row = " ".join(rows[name] for name in names)
            place = tokens[group.open].end
            edits.append(Edit(place, place, f" VALUES ({head}) {{ ({row}) }}"))
    return edits


def _uses(shape: Shape, parameters: Sequence[str]) -> list[str]:
    used = _variables(shape.tokens[shape.start : shape.end])
    return [name for name in parameters if name in used]


def _grouping_edits(shape: Shape, parameters: Sequence[str]) -> list[Edit]:
    """Make the parameters group keys where the query groups at all."""
    if not parameters or not shape.is_aggregated:
        return []
    group_by = shape.modifier("GROUP")
    present = _variables(group_by)
    missing = [name for name in parameters if name not in present]
    if not missing:
        return []
    keys = " ".join(f"?{name}" for name in missing)
    if group_by:
        return [Edit(group_by[-1].end, group_by[-1].end, f" {keys}")]
    place = shape.tokens[shape.where_close].end
    return [Edit(place, place, f" GROUP BY {keys}")]


def _alias_edits(shape: Shape) -> list[Edit]:
    """HAVING (?avg > 100) becomes HAVING ((AVG(?spd)) > 100); likewise in the head after it.

    rdflib and Oxigraph both know no alias in HAVING and silently answer nothing, and Oxigraph
    none in a later expression of a grouped head.
    """
    aliases = shape.aliases()
    if not aliases or not shape.is_aggregated:
        return []
    expressions: dict[str, str] = {}
    edits: list[Edit] = []
    for name, tokens in aliases.items():
        # An alias may use the aliases before it.
        edits += _replacements(tokens, expressions)
        expressions[name] = f"({_substituted(tokens, expressions)})"
    return edits + _replacements(shape.modifier("HAVING"), expressions)


def _replacements(tokens: Sequence[Token], expressions: Mapping[str, str]) -> list[Edit]:
    return [
        Edit(token.start, token.end, expressions[token.text[1:]])
        for token in tokens
        if token.kind is Kind.VARIABLE and token.text[1:] in expressions
    ]


def _substituted(tokens: Sequence[Token], expressions: Mapping[str, str]) -> str:
    parts: list[str] = []
    before: Token | None = None
    for token in tokens:
        # A literal and its datatype or language are one term.
        joined = token.is_mark("^^") or token.kind is Kind.LANGUAGE
        joined = joined or (before is not None and before.is_mark("^^"))
        parts.append("" if joined or before is None else " ")
        name = token.text[1:] if token.kind is Kind.VARIABLE else ""
        parts.append(expressions.get(name, token.text))
        before = token
    return "".join(parts)


def _aggregate_edits(query: ContinuousQuery, shape: Shape, parameters: Sequence[str]) -> list[Edit]:
    """WHERE {P} becomes WHERE {{SELECT keys (F(?x) AS ?a) WHERE {P} GROUP BY … HAVING …}}."""
    keys = " ".join(f"?{name}" for name in _keys(query, shape, parameters))
    calls = {a.alias.value: _call(a) for a in query.aggregations}
    projected = " ".join(f"({call} AS ?{alias})" for alias, call in calls.items())
    expressions = {alias: f"({call})" for alias, call in calls.items()}
    having = " ".join(
        _substituted(tokenize(text), expressions) for text, _ in query.aggregate_filters
    )
    opening = f" {{ SELECT {keys} {projected} WHERE {{"
    ending = "} "
    if keys:
        ending += f"GROUP BY {keys} "
    if having:
        ending += f"HAVING {having} "
    start, end = shape.tokens[shape.where_open].end, shape.tokens[shape.where_close].start
    return [Edit(start, start, opening), Edit(end, end, f"{ending}}} ")]


def _call(aggregation: Aggregation) -> str:
    return f"{aggregation.function}(?{aggregation.argument.value})"


def _keys(query: ContinuousQuery, shape: Shape, parameters: Sequence[str]) -> list[str]:
    aliases = {aggregation.alias.value for aggregation in query.aggregations}
    head = [name for name in shape.head_variables() if name not in aliases]
    return head + [name for name in parameters if name not in head]


def template_edit(sparql: str, shape: Shape) -> Edit:
    """CONSTRUCT WHERE {P} becomes CONSTRUCT {P} WHERE {P}: the short form bars VALUES."""
    pattern = sparql[shape.tokens[shape.where_open].start : shape.tokens[shape.where_close].end]
    word = shape.tokens[shape.start]
    return Edit(word.end, word.end, f" {pattern}")


def _variables(tokens: Sequence[Token]) -> set[str]:
    return {token.text[1:] for token in tokens if token.kind is Kind.VARIABLE}
