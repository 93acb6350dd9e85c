"""Laws of query texts, C-SPARQL and RSP-QL: what is printed means the same, keywords are keywords
only where they stand for one, and SPARQL is left in its place (SPEC §5)."""

import re
from collections.abc import Iterator
from dataclasses import replace

from hypothesis import assume, given, settings
from hypothesis import strategies as st

from dyknow.languages.csparql import (
    ContinuousQuery,
    Dialect,
    StreamOperator,
    body_sparql,
    format_query,
    parse_query,
)
from dyknow.languages.csparql.parser import read
from dyknow.languages.csparql.printer import compact
from dyknow.languages.errors import LanguageError
from dyknow.sparql.ast import NO_SPAN, Graph, variables_of, walk
from dyknow.sparql.tokens import UNLIMITED, Lexer, Token

WORDS = """register stream query as compute every select from named window on range step slide
tumbling triples elements landmark rstream istream dstream graph where aggregate filter prefix base
construct ask describe distinct template exists optional union group having values a true"""
KEYWORDS = WORDS.split()

keywords = st.sampled_from(KEYWORDS).flatmap(
    lambda word: st.sampled_from([word, word.upper(), word.capitalize()])
)
durations = st.sampled_from(["5s", "500 ms", "1M", "PT5S", "PT0.25S", '"P1D"^^xsd:duration'])
sizes = st.sampled_from(["1", "10", "2147483647"])
windows = st.one_of(
    st.builds("[RANGE {} STEP {}]".format, durations, durations),
    st.builds("[range {} Slide {}]".format, durations, durations),
    st.builds("[RANGE {} TUMBLING]".format, durations),
    st.builds("[TRIPLES {}]".format, sizes),
    st.builds("[ELEMENTS {} STEP {}]".format, sizes, sizes),
    st.builds("[Triples {} tumbling]".format, sizes),
    st.builds("[LANDMARK STEP {}]".format, durations),
    st.builds('[LANDMARK "1969-12-31T23:59:59.5Z"^^xsd:dateTime STEP {}]'.format, durations),
)
heads = st.sampled_from(
    ["REGISTER STREAM s COMPUTE EVERY 2s AS", "REGISTER QUERY :q AS", ""]
    + [f"REGISTER {operator} <out> EVERY PT2S AS" for operator in StreamOperator]
)
operators = st.sampled_from(["", *StreamOperator])
distinct = st.sampled_from(["", "DISTINCT", "reduced"])
forms = st.one_of(
    st.builds("SELECT {} {} ?x ?t".format, operators, distinct),
    st.builds("Select {} {}\n*".format, distinct, operators),
    st.builds("CONSTRUCT {} {{ ?x :of ?y }}".format, operators),
    st.just("ASK"),
    st.just("DESCRIBE ?x"),
)
patterns = st.sampled_from(
    [
        "?x :p ?y .",
        "WINDOW :w1 { ?x :p ?y }",
        "window ?w { ?x :p ?y }",
        "GRAPH ?g { ?x :p ?y }",
        "GRAPH :g1 { ?x :p (1 2) }",
        "OPTIONAL { WINDOW <http://example.org/w1> { ?x :window ?z } }",
        "{ WINDOW :w1 { ?x :p ?y } } UNION { ?x :graph ?y }",
        "FILTER NOT EXISTS { Window :w1 { ?x :q ?y } }",
        "{ SELECT ?x (COUNT(?z) AS ?n) { WINDOW :w1 { ?x :q ?z } } GROUP BY ?x }",
        "FILTER (f:timestamp(?x) < f:timestamp(?x, :p, ?y))",
        "BIND (dyknow-o:validTime(?y) AS ?b)",
    ]
)


@st.composite
def queries(draw: st.DrawFn) -> str:
    """A text of any dialect; one window is always called :w1."""
    clauses = [f"FROM NAMED WINDOW :w1 ON :s1 {draw(windows)}"]
    more = range(2, draw(st.integers(2, 4)))
    clauses += [f"FROM NAMED WINDOW :w{number} ON STREAM :s1 {draw(windows)}" for number in more]
    if draw(st.booleans()):
        clauses += [f"FROM WINDOW ON :s1 {draw(windows)}", f"FROM WINDOW :d ON :s1 {draw(windows)}"]
    if draw(st.booleans()):
        clauses.append(f"from stream :s2 {draw(windows)}")
    clauses += draw(st.lists(st.sampled_from(["FROM :g0", "FROM NAMED :g1", "FROM :g2"])))
    body = "\n  ".join(["?x :t ?t ; :y ?y .", *draw(st.lists(patterns, max_size=4, unique=True))])
    head, form = draw(heads), draw(forms)
    registered = next((o for o in StreamOperator if f"REGISTER {o}" in head), None)
    # A contradiction is an error, and has its golden case.
    form = re.sub(r"\b[RID]STREAM\b", lambda match: registered or match[0], form)
    text = draw(st.permutations(clauses))
    return f"PREFIX : <http://example.org/>\n{head}\n{form}\n" + "\n".join(text) + f"\n{{ {body} }}"


def meaning(query: ContinuousQuery) -> tuple[object, ...]:
    """All of a query but its spelling."""
    clauses = tuple(replace(clause, span=NO_SPAN) for clause in query.streams)
    conditions = tuple((condition, NO_SPAN) for condition, _ in query.aggregate_filters)
    said = replace(query, streams=clauses, source="", prefixes={}, aggregate_filters=conditions)
    return said, _unlabelled(body_sparql(query))


def _unlabelled(text: str) -> str:
    """Blank nodes that stand for ``[]`` and collections, by when they come."""
    labels: dict[str, str] = {}
    return re.sub(r"_:\w+", lambda m: labels.setdefault(m[0], f"_:{len(labels)}"), text)


@settings(deadline=None, max_examples=150)
@given(queries())
def test_a_printed_query_means_the_same(text: str) -> None:
    query = parse_query(text)
    printed = format_query(query)
    again = parse_query(printed)
    assert meaning(again) == meaning(query)
    assert format_query(again) == printed


@settings(deadline=None, max_examples=60)
@given(queries())
def test_windows_are_graphs_to_sparql(text: str) -> None:
    query = parse_query(text)
    windows = [one for one in walk(query.body) if isinstance(one, Graph) and one.is_window]
    assert len(windows) == len(re.findall(r"(?i)\bwindow (?=[?:<][\w:/.]+>? \{)", text))
    assert "WINDOW" not in {token.text.upper() for token in tokenize(body_sparql(query))}


spaces = st.sampled_from([" ", "\n", "\t", "  ", "\r\n", " # WINDOW :w { FROM STREAM ?\n"])


@settings(deadline=None, max_examples=60)
@given(queries(), st.data())
def test_space_comments_and_case_say_nothing(text: str, data: st.DataObject) -> None:
    query = parse_query(text)
    parts: list[str] = []
    touching = {"@", "^", "^^"}
    tokens = read(text)[0].tokens
    for before, token in zip((None, *tokens), tokens, strict=False):
        touches = before is not None and before.end == token.start
        # PT0.25S is three tokens, and a datatype touches its literal.
        if not touches or (before.text not in touching and token.text[0] not in "^@.0123456789S"):
            parts.append(data.draw(spaces))
        is_keyword = token.text.lower() in KEYWORDS and token.text != "a"
        parts.append(token.text.swapcase() if is_keyword else token.text)
    assert meaning(parse_query("".join(parts))) == meaning(query)


@settings(deadline=None, max_examples=150)
@given(st.lists(keywords, min_size=7, max_size=7), st.booleans())
def test_keywords_in_names_are_names(words: list[str], is_rsp_ql: bool) -> None:
    prefix, window, stream, property, variable, literal, graph = words
    ns = "http://example.org/FROM/STREAM#"
    windows = f"FROM NAMED WINDOW {prefix}:w-{window} ON {prefix}:{stream} [RANGE PT5S STEP PT1S]"
    pattern = (
        f'?{variable} {prefix}:{property} \'{literal} :w {{\', """FROM STREAM [""" . # {graph}'
    )
    if not is_rsp_ql:
        windows = f"FROM STREAM {prefix}:{stream} [RANGE 5s STEP 1s] # {window} [RANGE 1s]"
    else:
        pattern = f"WINDOW {prefix}:w-{window} {{ {pattern}\n }}"
    text = (
        f"PREFIX {prefix}: <{ns}>\nSELECT ?{variable} # {literal} ISTREAM\n"
        f"FROM {prefix}:g-{graph}\n{windows}\nWHERE {{ {pattern}\n"
        f" ?{variable} <{ns}{property}/WINDOW> {prefix}:{literal} }}"
    )
    query = parse_query(text)
    (clause,) = query.streams
    assert clause.iri == ns + stream
    assert clause.name == (f"{ns}w-{window}" if is_rsp_ql else None)
    assert query.static == (f"{ns}g-{graph}",)
    assert query.dialect is (Dialect.RSP_QL if is_rsp_ql else Dialect.C_SPARQL)
    assert query.operator is StreamOperator.RSTREAM
    assert query.window is None
    assert query.every is None
    assert list(variables_of(query.body)) == [variable]
    assert sum(isinstance(one, Graph) for one in walk(query.body)) == is_rsp_ql
    assert meaning(parse_query(format_query(query))) == meaning(query)


def tokenize(text: str) -> Iterator[Token]:
    return iter(Lexer(text, UNLIMITED).next, None)


def compacted(text: str) -> str:
    """What `compact` is: blank lines and white space before a line's end go, between tokens."""
    parts, end = [], 0
    for token in tokenize(text):
        between = re.sub(r"(?<![ \t])[ \t]*(?:\r?\n[ \t]*)*\r?\n", "\n", text[end : token.start])
        parts += (between, token.text)
        end = token.end
    return "".join(parts).strip()


PIECES = [
    *(
        "?a",
        "<http://x/'y#z>",
        "_:b",
        "ex:a\\'b",
        "ex:a\\#b",
        'ex:b\\"c',
        "'x'@en",
        "^^",
        "''",
        '""',
    ),
    *("'s # x  \\' '", '"q \\" "', '"""l \n\n  "x" \n"""', "'''m  \n\n '''"),
    *("# c ' \"  \n", "# d <a \t \r\n", "#\n", "# \\", "<", "<=", ">", "&&", "1.5e3"),
    *("  ", "\n", "\t", "\r", "\r\n", " \n \n", "\n\n\n"),
]


@given(st.lists(st.sampled_from(PIECES), max_size=12))
def test_only_blank_lines_between_tokens_go(pieces: list[str]) -> None:
    text = "".join([*pieces, "\n?end"])
    try:
        expected = compacted(text)
    except LanguageError:
        assume(False)
    assert compact(text) == expected
