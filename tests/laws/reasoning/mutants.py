"""Whether the laws of formulas and patterns see faults: each mutant of the product must fail one of them.

    python tests/laws/reasoning/mutants.py

It copies the package to a temporary folder, changes one place, and runs the law there until it
fails. Status 1 if a mutant survives. Part of ``make soak``.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[3]
PROGRESSION, ROBUSTNESS = "mtl/test_progression.py", "mtl/test_robustness.py"
STATES, MONITORING = "test_states.py", "mtl/test_monitoring.py"
PARTS, PART_EVALUATOR = "mtl/test_part_monitoring.py", "mtl/test_part_evaluator.py"
SLICED = "mtl/test_sliced.py"
EPSPARQL, SASE = "patterns/test_epsparql.py", "patterns/test_sase.py"
RECOGNITION, PARTIAL = "patterns/test_recognition.py", "patterns/test_partial_matches.py"
# ruff: noqa: E501
MUTANTS = (
    # An interval [a, b] closes when the horizon is at its end, not later.
    ("mtl/nodes.py", 'self.states.horizon.searchsorted(end, "left")', 'self.states.horizon.searchsorted(end, "right")', PROGRESSION),
    # `eventually` is false only once its interval is closed.
    ("mtl/nodes.py", "known = self.at if is_past else self.over(interval.end)", "known = self.at", PROGRESSION),
    # Both ends belong to an interval.
    ("mtl/nodes.py", 'later(valid, interval.end), "right"', 'later(valid, interval.end), "left"', PROGRESSION),
    ("mtl/nodes.py", 'later(valid, interval.start), "left"', 'later(valid, interval.start), "right"', PROGRESSION),
    ("mtl/nodes.py", 'earlier(valid, interval.end), "left"', 'earlier(valid, interval.end), "right"', PROGRESSION),
    # `previous` is false at the first state of all.
    ("mtl/nodes.py", "0 if self.is_whole else NEVER", "NEVER", PROGRESSION),
    # Nothing is known of a start before it.
    ("mtl/nodes.py", "np.maximum(true, self.at[:, None], out=true)", "pass", PROGRESSION),
    # A left part that fails makes `until` false at once.
    ("mtl/windows.py", "false = min(false, max(ruled_out, false_left[state, i]))", "pass", PROGRESSION),
    # `since` looks back from its own state.
    ("mtl/windows.py", "broken = min(broken, false_left[state, i])", "broken = false_left[state, i]", PROGRESSION),
    # The queue drops what has left the interval.
    ("mtl/windows.py", "queue[head] < first[start]:", "queue[head] <= first[start]:", PROGRESSION),
    # Unknown needs both readings.
    ("mtl/evaluator.py", "np.maximum(lower.false, upper.true)", "np.minimum(lower.false, upper.true)", PROGRESSION),
    # States that a later verdict needs are kept.
    ("mtl/evaluator.py", "keep = int(earliest(self._monitor.formula, row, partial(self._back, once))[0])", "pass", PROGRESSION),
    # Of a past without end the first state that decides it is remembered, in each reading; and the first of all.
    ("mtl/evaluator.py", "(False,) if once.is_known(formula) else (False, True)", "(False,)", PROGRESSION),
    ("mtl/evaluator.py", "needed[0] = True", "pass", PROGRESSION),
    # Parts of a batch are taken in turn.
    ("mtl/evaluator.py", "range(0, count, most)", "range(0, count - most, most)", PROGRESSION),
    # The state of a witness.
    ("mtl/witness.py", "(a <= b) if is_or is is_true else (a >= b)", "a <= b", PROGRESSION),
    ("mtl/windows.py", "least < max(held, closed)", "least <= max(held, closed)", PROGRESSION),
    # Margins of both readings.
    ("mtl/robustness.py", "np.inf if is_upper else -np.inf", "-np.inf", ROBUSTNESS),
    ("mtl/robustness.py", "return axes, -table", "return axes, table", ROBUSTNESS),
    # Over tables of bits: when an interval is over, which step decides, what is seen again.
    ("mtl/time_searches.py", "np.uint64(horizon - valid[row]) >= np.uint64(end)", "np.uint64(horizon - valid[row]) > np.uint64(end)", SLICED),
    ("mtl/bits/steps.py", "control[STEP] += is_new", "control[STEP] += 1", SLICED),
    ("mtl/bits/steps.py", "= bits if is_first else tables[new, row, word] | bits", "= bits", SLICED),
    ("mtl/bits/steps.py", "more & tables[left * TABLES + NEW, row, word]", "more", SLICED),
    ("mtl/bits/steps.py", "high = reached if is_true else min(high, reached)", "high = reached", SLICED),
    ("mtl/bits/verdicts.py", "if row < control[OPEN] or (side and stamp[lower, row] == control[STEP]):", "if side:", SLICED),
    ("mtl/bits/evaluator.py", "rows] = self._used[domain]", "rows] = ~np.uint64(0)", SLICED),
    ("mtl/bits/evaluator.py", "self._has_two_readings and self._last_unknown < self._oldest()", "self._has_two_readings", SLICED),
    ("mtl/bits/evaluator.py", "int(earliest(self._monitor.formula, row, self._back)) if self._looks_back else row", "row", SLICED),
    # A state leaves with the samples of its instant.
    ("states/kept_samples.py", 'left.searchsorted(rows.available, "left")', 'left.searchsorted(rows.available, "right")', STATES),
    ("states/kept_samples.py", "np.argsort(rows.valid, kind=\"stable\")", "np.argsort(-rows.valid, kind=\"stable\")", STATES),
    ("states/departures.py", "moments > last", "moments >= last", STATES),
    ("mtl/monitoring.py", "self._evaluator.advance(latest - 1)", "self._evaluator.advance(latest)", MONITORING),
    ("mtl/monitoring.py", "available=max(run.available, start.available)", "available=start.available", MONITORING),
    # A part has its own values, grid and first state.
    ("mtl/parts/evaluator.py", "known[part] for name", "known[0 * part] for name", PARTS),
    ("states/part_states.py", "np.maximum(steps.left(part, due), self._begun[part])", "steps.left(part, due)", PARTS),
    # Of a part's samples, the newest that has come counts; equal ones in the order of arrival.
    ("states/part_samples.py", "if samples[number, AVAILABLE, place] <= left[i]:", "if True:", PARTS),
    ("states/part_samples.py", "samples[number, VALID, place] > valid:", "samples[number, VALID, place] >= valid:", PARTS),
    ("states/part_samples.py", "if before >= 0 and samples[number, VALID, before] == valid[i]:", "if False:", MONITORING),
    ("states/kept_samples.py", 'np.argsort(found.available, kind="stable")', "np.arange(len(found.available))", STATES),
    # A part in the compiled loop: its program, what it keeps, its first state, its witnesses.
    ("mtl/parts/loop.py", "row = max(row - 1, 0)", "pass", PART_EVALUATOR),
    ("mtl/parts/margins.py", "if low == 0 or high == 0:", "if False:", PART_EVALUATOR),
    ("mtl/parts/margins.py", "tables[b, row] = other * tables[right, row]", "tables[b, row] = tables[right, row]", PART_EVALUATOR),
    ("mtl/parts/margins.py", "unknown = np.inf if nodes[node, IS_UPPER] else -np.inf", "unknown = -np.inf", PART_EVALUATOR),
    ("mtl/parts/loop.py", "row = back(valid, row, nodes[node, END])", "pass", PART_EVALUATOR),
    ("mtl/parts/loop.py", "if row < keep and not is_kept[row]:", "if False:", PART_EVALUATOR),
    ("mtl/parts/witness.py", "is_left = a >= b if side else a <= b", "is_left = a <= b", PART_EVALUATOR),
    ("mtl/parts/witness.py", "hint[0] == node and hint[1] <= row and by <= hint[2]", "hint[0] == node", PART_EVALUATOR),
    ("mtl/parts/witness.py", " or (at == count - 1 and horizon[at] == TIME_MAX)", "", PART_EVALUATOR),
    ("mtl/parts/evaluator.py", "has_end = node[programs.END] != programs.NO_END", "has_end = False", PART_EVALUATOR),
    # Progression of parts: what is known by a moment, runs of rows decided at once, cursors.
    ("mtl/parts/loop.py", "program = 1 if parts[own, LAST_UNKNOWN] >= 0 else 0", "program = 0", PART_EVALUATOR),
    ("mtl/parts/loop.py", "if has_margins or parts[own, PROGRAM] != program:", "if has_margins or parts[own, PROGRAM] < 0:", PART_EVALUATOR),
    ("mtl/parts/loop.py", "is_found = row >= 0 and kinds[node] & REMEMBERED", "is_found = False", PART_EVALUATOR),
    ("mtl/parts/loop.py", "parts[part, FIRST_OPEN] -= begin", "pass", PART_EVALUATOR),
    ("mtl/parts/loop.py", "if is_done[at] == 2:", "if is_done[at]:", PART_EVALUATOR),
    ("mtl/parts/loop.py", "while to > 0 and rows[to - 1] > at:", "while False:", PART_EVALUATOR),
    ("mtl/parts/layout.py", "found & 3 == (2 | (table & 1)) and found >> 2 <= now", "found & 3 == (2 | (table & 1))", PART_EVALUATOR),
    ("mtl/parts/layout.py", "column[row] != PENDING and column[row] >> 2 <= now", "column[row] != PENDING", PART_EVALUATOR),
    ("mtl/parts/progression.py", "if at <= row and mine[at] == PENDING:", "if False:", PART_EVALUATOR),
    ("mtl/parts/progression.py", "is_left = one <= another", "is_left = one < NEVER", PART_EVALUATOR),
    ("mtl/parts/progression.py", "            if lowest < first:\n                done = -1\n", "", PART_EVALUATOR),
    ("mtl/parts/progression.py", "        if first > open:\n            open = first\n", "        if first > open:\n            open = row + 1\n", PART_EVALUATOR),
    ("mtl/parts/progression.py", "done_from, lowest = open + 1, max(low, behind(valid, open, start))", "done_from, lowest = open + 1, low", PART_EVALUATOR),
    ("mtl/parts/progression.py", "                if after <= row and is_near(valid, each, after, end):\n                    break\n", "", PART_EVALUATOR),
    ("mtl/parts/progression.py", "max(lowest, open + 1), behind(valid, at, start)", "lowest, behind(valid, at, start)", PART_EVALUATOR),
    ("mtl/parts/progression.py", "            elif low <= at < row:", "            elif False:", PART_EVALUATOR),
    ("mtl/parts/progression.py", "        if own[LAST_FAILED] >= low:\n            done_from", "        if False:\n            done_from", PART_EVALUATOR),
    ("mtl/parts/progression.py", "if not done_from <= at < done_to:", "if at >= done_to:", PART_EVALUATOR),
    ("mtl/parts/progression.py", "own[LAST_TRUE] = max(own[LAST_TRUE], at)", "pass", PART_EVALUATOR),
    ("mtl/parts/progression.py", "if earliest < row or not is_new:", "if not is_new:", PART_EVALUATOR),
    ("mtl/parts/progression.py", "has_failed = has_failed or is_by(lefts, nodes[node, LEFT_F], at, now)", "pass", PART_EVALUATOR),
    ("mtl/parts/progression.py", "if true >= max(open, 0) and", "if true >= 0 and", PART_EVALUATOR),
    ("mtl/parts/progression.py", "elif possible < max(failed, 0) or", "elif possible < 0 or", PART_EVALUATOR),
    ("mtl/parts/progression.py", "first = low if open < 0 else max(low, reach(valid, open, end, row + 1))", "first = low", PART_EVALUATOR),
    ("mtl/parts/progression.py", "last = row + 1 if after > row else ahead(valid, after, start, row + 1)", "last = row + 1", PART_EVALUATOR),
    ("mtl/parts/evaluator.py", "self._out[:count].T.copy()", "np.ascontiguousarray(self._out[:count].T)", PARTS),
    # SEQ is strict; EQUALS is of both times.
    ("patterns/compilation/epsparql_plans.py", "plan.Point(other, is_start=True), 1)", "plan.Point(other, is_start=True), 0)", EPSPARQL),
    ("patterns/compilation/epsparql_plans.py", "hulls=tuple(hulls)", "hulls=()", EPSPARQL),
    # What a condition decides in a branch.
    ("patterns/compilation/epsparql_branches.py", "if part == Truth(decides)", "if part == Truth(not decides)", EPSPARQL),
    ("patterns/compilation/epsparql_branches.py", "return condition if has_values else Truth(False)", "return condition if has_values else Truth(True)", EPSPARQL),
    # Alone waits until no sample of its time may come, and what excludes it is kept so long.
    ("patterns/recognition/combined.py", "outputs[absence.until] + 1", "outputs[absence.until]", EPSPARQL),
    ("patterns/recognition/combined.py", "until = due + self.span + 1", "until = due", EPSPARQL),
    ("patterns/recognition/combined.py", "self.until[0][0] < watermark", "self.until[0][0] < TIME_MIN", EPSPARQL),
    # Each solution of static triples is a result.
    ("patterns/recognition/static_tables.py", ".append(found)", "[:] = [found]", EPSPARQL),
    # Conditions on static values hold; a division by 0 has no value.
    ("patterns/recognition/combined.py", "if join.tests:", "if not join.tests:", EPSPARQL),
    ("patterns/recognition/output_tests.py", "known & (right != 0)", "known", EPSPARQL),
    # -0 equals 0, and each event has the key of its own value.
    ("patterns/plans/query.py", "numbers = values + 0.0", "numbers = values", SASE),
    # With a max delay a time is over that long after it, and absence is known of the time before.
    ("patterns/recognition/recognition.py", "later(found.decided - waited, steps.delay)", "later(found.decided, steps.delay)", RECOGNITION),
    ("patterns/recognition/recognition.py", '"right" if steps.delay is None else "left"', '"right"', RECOGNITION),
    # A repeated part that goes on moves the bounds that begin with its last row.
    ("patterns/recognition/partial.py", "if v != low_only}", "}", PARTIAL),
)  # fmt: skip
"""The file in ``reasoning``, the text in it, what stands there instead, the law that sees it."""


def survives(file: str, text: str, other: str, law: str) -> bool:
    """Whether the law holds of a mutant."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "dyknow"
        ignored = shutil.ignore_patterns(".*", "__pycache__", "docs", "examples", "service")
        shutil.copytree(ROOT, copy, ignore=ignored)
        shutil.copytree(ROOT / "service" / "config", copy / "service" / "config")
        shutil.copy(ROOT / "service" / "__init__.py", copy / "service")
        place = copy / "reasoning" / file
        source = place.read_text()
        if source.count(text) != 1:
            raise SystemExit(f"{text!r} stands {source.count(text)} times in {file}")
        place.write_text(source.replace(text, other))
        path = f"tests/laws/reasoning/{law}"
        command = [sys.executable, "-m", "pytest", "-n", "0", "-q", "-x", "-p", "no:cacheprovider"]
        environment = {**os.environ, "PYTHONPATH": folder, "PYTHONDONTWRITEBYTECODE": "1"}
        done = subprocess.run(
            [*command, path], cwd=copy, env=environment, capture_output=True, text=True, check=False
        )
        if done.returncode not in (0, 1):
            raise SystemExit(done.stdout + done.stderr)
        return done.returncode == 0


def main() -> None:
    survivors = 0
    for file, text, *rest in MUTANTS:
        begun = time.monotonic()
        found = survives(file, text, *rest)
        survivors += found
        word = "SURVIVED" if found else "caught"
        place = text.splitlines()[0][:70]
        print(f"{word:8} {time.monotonic() - begun:5.0f} s  {file}: {place}", flush=True)
    sys.exit(survivors > 0)


if __name__ == "__main__":
    main()
