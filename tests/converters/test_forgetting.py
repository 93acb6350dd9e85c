"""Tables from names and spellings to ids: what was forgotten is found anew."""

import numpy as np
import pytest
from pyoxigraph import Literal, NamedNode

from dyknow.converters.objects import ObjectTable
from dyknow.converters.rdf.ntriples import TripleReader
from dyknow.converters.term_tables import PoolTable, TermTexts, TextTable
from dyknow.rdf.dictionary import TermDictionary
from dyknow.streams.sample import Column, FieldType
from dyknow.streams.string_pool import StringPool

PLACE = "http://example.org/"
LONG = '"1.2345678901234567890123"^^<http://www.w3.org/2001/XMLSchema#double>'


def test_spellings_are_read_anew() -> None:
    dictionary = TermDictionary()
    reader = TripleReader(dictionary, least=0)
    for turn in range(6):
        names = [f"o{turn}", "always", f"o{turn - 2}"][:: 1 if turn % 2 else -1]
        text = "".join(f'<{PLACE}{n}> <{PLACE}p> "text of {n}" .\n' for n in names)
        text += f"<{PLACE}a> <{PLACE}p> {LONG} .\n"
        read = reader.triples(text.encode(), turn)
        told = {(s, o) for _, s, _, o in read if s != NamedNode(f"{PLACE}a")}
        assert told == {(NamedNode(PLACE + n), Literal(f"text of {n}")) for n in names}
        del read, told
        dictionary._sweep()
        assert len(reader._known) == dictionary.count == 0


def column(names: list[str], pool: StringPool) -> Column:
    return Column(FieldType.STRING, pool.encode(names), None, pool)


@pytest.mark.parametrize("keeps", [False, True])
def test_names_of_objects_are_found_anew(keeps) -> None:
    dictionary, pool = TermDictionary(), StringPool()
    table = ObjectTable(dictionary, PLACE, keeps=keeps)
    numbers = np.array([5, 7, 2**40], np.int64)
    for turn in range(6):
        names = [f"o{turn}", "always", f"o{turn - 2}"][:: 1 if turn % 2 else -1]
        more = numbers + turn % 3
        if turn % 2:
            by_name, by_number = (table.of_column(c) for c in (column(names, pool), whole(more)))
        else:
            by_number, by_name = (table.of_column(c) for c in (whole(more), column(names, pool)))
        assert [dictionary.term(id) for id in by_name.tolist()] == [
            NamedNode(PLACE + name) for name in names
        ]
        assert [dictionary.term(id) for id in by_number.tolist()] == [
            NamedNode(f"{PLACE}{number}") for number in more.tolist()
        ]
        dictionary._sweep()
        assert (dictionary.count > 0) is keeps
    del table
    dictionary._sweep()
    assert not dictionary.count


def whole(values) -> Column:
    return Column(FieldType.INTEGER, values)


def test_a_text_is_asked_for_once_while_it_is_known() -> None:
    dictionary, pool, asked = TermDictionary(), StringPool(), []

    def term(text: str) -> int:
        asked.append(text)
        return dictionary.transient_id(Literal(text))

    table = PoolTable(term, dictionary)
    for _ in range(2):
        table.of_codes(pool.encode(["a", "b", "a"]), pool)
    table.of_codes(pool.encode(["c"]), pool)
    assert asked == ["a", "b", "c"]
    dictionary.id(Literal("b"))
    dictionary._sweep()
    table.of_codes(pool.encode(["c", "b", "a", "b"]), pool)
    assert sorted(asked[3:]) == ["a", "c"]


def test_texts_of_terms_are_found_anew() -> None:
    dictionary, asked = TermDictionary(), []

    def text(term: NamedNode) -> str:
        asked.append(term.value)
        return term.value.removeprefix(PLACE)

    table, pool = TextTable(text, dictionary), StringPool(["other"])
    for turn in range(4):
        names = [f"o{turn}", "always", f"o{turn - 2}", "always"]
        if turn == 3:
            pool = StringPool()
        ids = dictionary.transient_ids(NamedNode(PLACE + name) for name in names)
        for _ in range(2):
            assert [pool[code] for code in table.of_ids(ids, pool).tolist()] == names
        if turn == 1:
            dictionary._sweep()
    assert asked.count(PLACE + "always") == 3, "once, after the sweep, and for the second pool"


def test_texts_of_terms_are_those_of_the_terms_that_have_the_ids_now() -> None:
    dictionary = TermDictionary()
    texts = TermTexts(dictionary)
    for turn in range(6):
        terms = [Literal(f"{turn}"), NamedNode(f"{PLACE}{turn - 1}"), Literal(f"{turn}" * 300)]
        ids = dictionary.transient_ids(terms[:: 1 if turn % 2 else -1])
        for _ in range(2):
            assert texts.of_ids(ids) == [str(dictionary.term(id)) for id in ids.tolist()]
        dictionary._sweep()
        assert not dictionary.count
