"""CityBench's six queries: what one evaluation costs, here and with Oxigraph on the same windows.

    python bench/queries/citybench.py

Windows are 3 s every second, a record a second of each stream (`slow`) and five (`fast`). *here*
is the time from the watermark that closes a window to its result in columns; *with rows* adds
pushing the triples of that second, as columns. *Oxigraph* keeps its store from window to window
(static triples stay, content is removed and added); its time is that of removing, adding, asking
and counting the solutions. The windows give the same number of solutions. Needs ../shared.
"""

from __future__ import annotations

import gc
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from pyoxigraph import Quad, Store

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / name) for name in ("support", "support/worlds", "definitions")]

import citybench  # noqa: E402
from citybench import SECOND, SERVICE, Schedule  # noqa: E402

from dyknow.continuous.evaluation.evaluator import ContinuousEvaluator  # noqa: E402
from dyknow.continuous.operators.background import Background  # noqa: E402
from dyknow.languages.csparql import body_sparql, parse_query  # noqa: E402
from dyknow.rdf.dictionary import TermDictionary  # noqa: E402
from dyknow.rdf.terms_to_columns import from_terms  # noqa: E402

RANGE = 3 * SECOND
SCHEDULES = {"slow": Schedule(SECOND, SECOND // 4), "fast": Schedule(SECOND // 5, SECOND // 15)}
RECORDS = {"slow": 60, "fast": 300}
# Q2 joins everything with everything: five records a second make millions of solutions.
FEWER = {(2, "fast"): 20}


def seconds_of(streams: dict[str, list]) -> list[dict[str, list]]:
    """The triples of each stream, second by second: those of (t - 1 s, t]."""
    last = max(triple[0] for triples in streams.values() for triple in triples)
    return [
        {
            name: [triple for triple in triples if end - SECOND < triple[0] <= end]
            for name, triples in streams.items()
        }
        for end in range(SECOND, last + SECOND, SECOND)
    ]


def here(text: str, seconds: Sequence[dict[str, list]], static: Path) -> tuple[list, list, list]:
    """Times of evaluations, those with pushing, and the numbers of solutions."""
    dictionary = TermDictionary()
    evaluator = ContinuousEvaluator(
        parse_query(text),
        dictionary,
        Background.from_files([static, citybench.cultural_events()]),
        list(seconds[0]),
    )
    columns = [
        {name: from_terms(triples, dictionary) for name, triples in second.items()}
        for second in seconds
    ]
    evaluations, whole, counts = [], [], []
    for number, second in enumerate(columns, 1):
        begin = time.perf_counter()
        for name, triples in second.items():
            evaluator.push(name, triples)
        pushed = time.perf_counter()
        found = [
            result for name in second for result in evaluator.advance(name, number * SECOND + 1)
        ]
        end = time.perf_counter()
        evaluations.append(end - pushed)
        whole.append(end - begin)
        counts.append(sum(result.size for result in found))
    return evaluations, whole, counts


def oxigraph(text: str, seconds: Sequence[dict[str, list]], static: Path) -> tuple[list, list]:
    sparql = body_sparql(parse_query(text))
    store = Store()
    for quad in Background.from_files([static, citybench.cultural_events()]).store:
        store.add(Quad(quad.subject, quad.predicate, quad.object))
    quads = [
        [Quad(s, p, o) for triples in second.values() for _, s, p, o in triples]
        for second in seconds
    ]
    times, counts = [], []
    span = RANGE // SECOND
    for number, content in enumerate(quads):
        begin = time.perf_counter()
        for quad in quads[number - span] if number >= span else ():
            store.remove(quad)
        store.extend(content)
        counts.append(sum(1 for _ in store.query(sparql)))
        times.append(time.perf_counter() - begin)
    return times, counts


def main() -> int:
    """Print the table."""
    if not citybench.FOLDER.exists():
        print(f"CityBench is not here: {citybench.FOLDER}")
        return 0
    # Collecting what the benchmark itself makes is nobody's evaluation (as `timeit`).
    gc.disable()
    agree = True
    print("CityBench: µs an evaluation, median; solutions a window, median")
    print(f"{'':<10}{'here':>10}{'with rows':>12}{'Oxigraph':>12}{'ratio':>8}{'solutions':>12}")
    with tempfile.TemporaryDirectory() as folder:
        static = citybench.sensor_repository(Path(folder))
        for name, schedule in SCHEDULES.items():
            for number in range(1, 7):
                text = citybench.query(number)
                inputs = [clause.iri.removeprefix(SERVICE) for clause in parse_query(text).streams]
                records = FEWER.get((number, name), RECORDS[name])
                seconds = seconds_of(citybench.replayed(inputs, schedule, records))
                evaluations, whole, counts = here(text, seconds, static)
                slow, wanted = oxigraph(text, seconds, static)
                agree &= counts == wanted
                # The first windows are not full, and the first call loads the loops.
                ours, rows, theirs = (
                    statistics.median(times[3:]) * 1e6 for times in (evaluations, whole, slow)
                )
                print(
                    f"Q{number} {name:<7}{ours:>10.0f}{rows:>12.0f}{theirs:>12.0f}"
                    f"{theirs / rows:>8.1f}{statistics.median(counts[3:]):>12.0f}"
                )
    print(f"same numbers of solutions: {agree}")
    return 0 if agree else 1


if __name__ == "__main__":
    sys.exit(main())
