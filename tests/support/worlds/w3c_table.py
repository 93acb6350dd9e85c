"""The table of docs/reference/sparql-conformance.md, measured by
`PYTHONPATH=tests/definitions/queries:tests/support python tests/support/worlds/w3c_table.py`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

from w3c_sparql import KNOWN, SYNTAX, Outcome, Record, cases, is_parsed_rightly, record


def tables() -> str:
    """Both tables and their notes, as Markdown."""
    records = [record(case) for case in cases() if case.kind not in SYNTAX]
    return "\n\n".join([_evaluation(records), _left_out(records), _failed(records), _syntax()])


def _evaluation(records: Sequence[Record]) -> str:
    rows = [
        (folder, len(group), *(sum(r.outcome is o for r in group) for o in Outcome))
        for folder, group in _by_folder(records)
    ]
    total = ("all", *(sum(row[i] for row in rows) for i in range(1, 6)))
    return _table(("folder", "tests", *Outcome), [*rows, total])


def _left_out(records: Iterable[Record]) -> str:
    reasons = Counter((r.reason, r.case.folder) for r in records if r.outcome is Outcome.LEFT_OUT)
    rows = [
        (reason, ", ".join(f"{f} {n}" for (r, f), n in reasons.items() if r == reason))
        for reason in dict.fromkeys(reason for reason, _ in reasons)
    ]
    return _table(("left out because", "where"), rows)


def _failed(records: Iterable[Record]) -> str:
    return _table(
        ("failed", "why"),
        [
            (r.case.name, KNOWN.get(r.case.name, "not known"))
            for r in records
            if r.outcome is Outcome.FAILED
        ],
    )


def _syntax() -> str:
    tests = [(case, is_parsed_rightly(case)) for case in cases() if case.kind in SYNTAX]
    rows = []
    for folder in dict.fromkeys(case.folder for case, _ in tests):
        row: list[object] = [folder]
        for kind in SYNTAX:
            right = [right for case, right in tests if case.folder == folder and case.kind == kind]
            row.append(f"{sum(right)} of {len(right)}")
        rows.append(row)
    wrong = [case.name for case, right in tests if not right]
    reasons = Counter(KNOWN.get(name, f"not known: {name}") for name in wrong)
    return "\n\n".join(
        [
            _table(("folder", "right texts taken", "wrong texts refused"), rows),
            _table(("not as expected", "why"), [(n, reason) for reason, n in reasons.items()]),
        ]
    )


def _by_folder(records: Sequence[Record]) -> list[tuple[str, list[Record]]]:
    folders = dict.fromkeys(r.case.folder for r in records)
    return [(folder, [r for r in records if r.case.folder == folder]) for folder in folders]


def _table(head: Sequence[object], rows: Iterable[Sequence[object]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(map(str, line))} |" for line in lines)


if __name__ == "__main__":
    print(tables())
