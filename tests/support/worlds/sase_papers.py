"""The patterns that the papers on SASE and SASE+ print, and random events for them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from random import Random

from sase_definition import Event

from dyknow.languages.mtl.checked import Kind
from dyknow.rdf.namespaces import DYKNOW
from dyknow.streams.time import MINUTE, SECOND

Values = tuple[str, ...] | tuple[float, ...]


@dataclass(frozen=True)
class Printed:
    """A text; by type the fields of its events with the values that are drawn; and ``step`` (ns):
    the times of events are multiples of it. ``limit``: what DyKnow wants at the end of the text."""

    text: str
    fields: Mapping[str, Mapping[str, Values]]
    step: int
    limit: str = ""

    @property
    def kinds(self) -> dict[tuple[str, str], Kind]:
        return {
            (type_, name): Kind.TEXT if isinstance(values[0], str) else Kind.NUMBER
            for type_, fields in self.fields.items()
            for name, values in fields.items()
        }

    @property
    def texts(self) -> set[str]:
        """The attributes that are texts or objects."""
        return {"id", *(name for (_, name), kind in self.kinds.items() if kind is Kind.TEXT)}

    def events(self, draw: Random, count: int) -> list[Event]:
        times = sorted(self.step * draw.randrange(2 * count) for _ in range(count))
        return [self.event(draw, i, time) for i, time in enumerate(times)]

    def event(self, draw: Random, number: int, time: int) -> Event:
        type_ = draw.choice(list(self.fields))
        drawn = {name: draw.choice(values) for name, values in self.fields[type_].items()}
        owner = f"<{DYKNOW}{draw.choice(['o1', 'o2'])}>"
        return Event(number, type_, time, {**drawn, "id": owner})


STOCKS: Mapping[str, Mapping[str, Values]] = {
    "Stock": {"symbol": ("ibm", "ibm", "sun"), "price": (1.0, 2.0, 3.0), "volume": (50.0, 150.0)}
}
PRINTED = {
    # Wu, Diao and Rizvi, SIGMOD 2006, Q1 and Q2, where EVENT is what PATTERN is since.
    "shoplifting": Printed(
        """
        PATTERN SEQ(SHELF_READING x, !(COUNTER_READING y), EXIT_READING z)
        WHERE x.id = y.id ∧ x.id = z.id // all of one item
        WITHIN 12 hours""",
        {"SHELF_READING": {}, "COUNTER_READING": {}, "EXIT_READING": {}},
        120 * MINUTE,
    ),
    "misplaced inventory": Printed(
        """
        PATTERN SEQ(SHELF_READING x, SHELF_READING y, ~(ANY(COUNTER_READING, SHELF_READING) z))
        WHERE [id] ∧ x.shelf_id != y.shelf_id ∧ x.shelf_id = z.shelf_id
        WITHIN 1 hour""",
        {
            "SHELF_READING": {"shelf_id": ("left", "right")},
            "COUNTER_READING": {"shelf_id": ("left", "right")},
        },
        10 * MINUTE,
    ),
    # Gyllstrom, Agrawal, Diao and Immerman, ICDE 2008; Agrawal, Diao, Gyllstrom and Immerman,
    # SIGMOD 2008: queries 1 to 3.
    "contamination": Printed(
        """
        PATTERN SEQ(Alert a, Shipment+ b[ ])
        WHERE skip_till_any_match(a, b[ ]) {
            a.type = 'contaminated' and
            b[1].from = a.site and
            b[i].from = b[i-1].to }
        WITHIN 3 hours""",
        {
            "Alert": {"type": ("contaminated", "late"), "site": ("x", "y")},
            "Shipment": {"from": ("x", "y", "z"), "to": ("x", "y", "z")},
        },
        20 * MINUTE,
        " LIMIT 1000",
    ),
    "volume": Printed(
        """
        PATTERN SEQ(Stock+ a[ ], Stock b)
        WHERE skip_till_next_match(a[ ], b) {
            [symbol] and
            a[1].volume > 1000 and
            a[i].price > avg(a[..i-1].price) and
            b.volume < 80%*a[a.LEN].volume }
        WITHIN 1 hour""",
        {
            "Stock": {
                "symbol": ("ibm", "ibm", "sun"),
                "price": (1.0, 2.0, 3.0, 4.0),
                "volume": (700.0, 950.0, 1010.0, 1500.0),
            }
        },
        5 * MINUTE,
    ),
    "rising": Printed(
        """
        PATTERN SEQ(Stock+ a[ ], Stock b)
        WHERE partition_contiguity(a[ ], b) {
            [symbol] and a[i].price > a[i-1].price and b.price < a[a.LEN].price }
        WITHIN 500 seconds
        HAVING avg(a[].volume) > 100
        RETURN a[1].symbol, a[].price AS prices, count(a[]) AS n""",
        STOCKS,
        50 * SECOND,
    ),
    # Poppe, Lei, Rundensteiner and Maier, PVLDB 2017 (GRETA), Q1 in the clauses of this grammar.
    "trends": Printed(
        """
        PATTERN Stock+ s[]
        WHERE skip_till_any_match { [company] and s[i].price < s[i-1].price }
        WITHIN 10 minutes RETURN COUNT(*), AVG(s.price)""",
        {"Stock": {"company": ("ibm", "sun"), "price": (1.0, 2.0, 3.0, 4.0)}},
        MINUTE,
    ),
}
