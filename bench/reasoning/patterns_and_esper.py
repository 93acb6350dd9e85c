"""Patterns beside Esper 9: events a second of processor time, and the ratio.

    python bench/reasoning/patterns_and_esper.py

Needs Java and Maven. 100,000 events of five kinds come one a second, in batches of 1,000; the rows
of matches are written on both sides, decoding is not included. Each side takes the least of three
runs; of Java only the thread that evaluates counts, and neither its compiler nor its collector.
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / "support" / "worlds")]

from esper import ANY, ENDING_WITHOUT_D, NEXT, WITHOUT_D, Esper  # noqa: E402
from pattern_data import batches, data, sequence  # noqa: E402

from dyknow.reasoning.patterns.plans.plan import PatternPlan, Selection  # noqa: E402
from dyknow.reasoning.patterns.recognition.choice import evaluator_of  # noqa: E402
from dyknow.streams import jit  # noqa: E402

jit.PATIENCE = 0.0  # loops are compiled from the first call on

RUNS = 3
NEXT_MATCH = Selection.NEXT_MATCH


@dataclass(frozen=True)
class Case:
    name: str
    plan: PatternPlan
    pattern: str
    columns: int
    keys: int
    aim: int


CASES = (
    Case("any A;B;C", sequence("ABC"), ANY, 3, 10, 15),
    Case("any A;B;C", sequence("ABC"), ANY, 3, 100, 10),
    Case("any A;B;C", sequence("ABC"), ANY, 3, 10_000, 10),
    *(
        Case("next A;B;C", replace(sequence("ABC"), selection=NEXT_MATCH), NEXT, 3, keys, 25)
        for keys in (10, 100, 10_000)
    ),
    Case("any A;~D;C", sequence("A~DC"), WITHOUT_D, 2, 100, 5),
    Case("any A;~D", sequence("A~D"), ENDING_WITHOUT_D, 1, 100, 3),
)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        esper = Esper(Path(folder))
        for case in CASES:
            rows = data(100_000, case.keys)
            parts = list(batches(rows, 1000))
            theirs = esper.run(case.pattern, rows, case.columns, RUNS)
            seconds, found = float("inf"), 0
            for _ in range(RUNS):
                begun = time.process_time()
                running = evaluator_of(case.plan)
                found = sum(len(running.push(part)) for part in parts)
                seconds = min(seconds, time.process_time() - begun)
            same = "" if found == len(theirs.rows) else f", and Esper finds {len(theirs.rows):,}"
            print(
                f"{case.name:12} {case.keys:6,} keys {0.1 / seconds:7.2f} M events/s, Esper "
                f"{0.1 / theirs.seconds:5.2f}: {theirs.seconds / seconds:5.1f} × (aim {case.aim}); "
                f"{found:,} matches{same}",
                flush=True,
            )


if __name__ == "__main__":
    main()
