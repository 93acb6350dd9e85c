"""Laws of KPL: what is printed says the same, and every refusal has its place."""

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from dyknow.languages.errors import LanguageError
from dyknow.languages.kpl import (
    CheckedDeclaration,
    Signature,
    check_kpl,
    format_kpl,
    format_policy,
    parse_kpl,
    parse_policy,
)
from dyknow.streams.policy import (
    AnyChange,
    AnyUpdate,
    Approximation,
    Duration,
    Order,
    Policy,
    PolicyError,
    SampleEvery,
    SynchronizationPolicy,
)
from dyknow.streams.time import TIME_MAX, TIME_MIN

UNITS = ("ns", "us", "ms", "s")
steps = st.sampled_from([1, 1_000, 1_000_000, 1_500_000_000])
units = st.sampled_from(UNITS)
lengths = st.integers(1, 5000).flatmap(lambda n: steps.map(lambda step: n * step))
delays = st.just(0) | lengths | st.just(TIME_MAX)
times = st.integers(TIME_MIN, TIME_MAX) | lengths | lengths.map(lambda n: -n)
durations = st.builds(
    lambda start, end, to_oo: Duration(start, end, to_oo and end is None),
    st.none() | times,
    st.none() | times,
    st.booleans(),
)
changes = st.just(AnyUpdate()) | st.just(AnyChange()) | delays.filter(bool).map(SampleEvery)
parts = (changes, st.none() | delays, durations, st.sampled_from(Order))


@st.composite
def policies(draw: st.DrawFn) -> Policy:
    values = [draw(part) for part in parts]
    try:
        return Policy(*values, draw(st.sampled_from(Approximation)))
    except PolicyError:
        return Policy(*values)


@settings(deadline=None, max_examples=200)
@given(policies(), units)
def test_a_printed_policy_is_read_again(policy: Policy, unit: str) -> None:
    assert parse_policy(format_policy(policy, unit), unit) == policy


@settings(deadline=None, max_examples=100)
@given(policies(), policies())
def test_a_list_of_constraints_is_their_conjunction(one: Policy, other: Policy) -> None:
    """A policy with itself is itself, in any order of its constraints; with another, no looser."""
    text, more = format_policy(one, "ns"), format_policy(other, "ns")
    assert parse_policy(", ".join(filter(None, [text, text])), "ns") == one
    assert parse_policy(", ".join(reversed(text.split(", "))) if text else "", "ns") == one
    joined = ", ".join(filter(None, [text, more]))
    periods = {p.period for p in (one, other)} - {None}
    if len(periods) == 2:
        with pytest.raises(LanguageError, match="two sample periods"):
            parse_policy(joined, "ns")
        return
    both = parse_policy(joined, "ns")
    turned = parse_policy(", ".join(filter(None, [more, text])), "ns")
    assert both == turned
    assert both.duration.first == max(one.duration.first, other.duration.first)
    assert both.duration.last == min(one.duration.last, other.duration.last)
    bounds = [p.max_delay for p in (one, other) if p.max_delay is not None]
    assert both.max_delay == min(bounds, default=None)


@st.composite
def specifications(draw: st.DrawFn) -> str:
    """Texts that make sense: every name stands on what is declared."""
    sorts = ["float", "integer", "string", "mood", "pair"]
    lines = ["sort pair = (x float, y integer)"]
    made: list[tuple[str, str]] = []
    for i in range(draw(st.integers(1, 3))):
        sort = draw(st.sampled_from(sorts))
        objects = draw(st.sampled_from(["", "[]", "[a]", "[a, every_b]"]))
        lines += [f"source {sort} s{i}", f"strmgen f{i}{objects} = s{i}"]
        made.append((f"f{i}{objects}", sort))

    def term() -> tuple[str, str]:
        label, sort = draw(st.sampled_from(made))
        policy = format_policy(draw(policies()))
        return (f"{label} with {policy}" if policy else label), sort

    for i in range(draw(st.integers(0, 4))):
        terms = [term() for _ in range(draw(st.integers(1, 3)))]
        inputs = ", ".join(text for text, _ in terms)
        match draw(st.integers(0, 3)):
            case 0:
                lines.append(f"strmgen j{i} = join({inputs})")
                made.append((f"j{i}", f"j{i}"))
            case 1:
                values = [draw(part) for part in parts]
                assume(values[0] != AnyUpdate())
                policy = SynchronizationPolicy(*values, draw(st.sampled_from(Approximation)))
                text = format_policy(policy).replace(", ", draw(st.sampled_from([", ", "; "])))
                lines.append(f"strmgen y{i}[o] = sync({inputs}; {text})")
                made.append((f"y{i}[o]", f"y{i}"))
            case 2:
                lines.append(f"compunit mood C{i}({', '.join(sort for _, sort in terms)})")
                lines.append(f"strmgen c{i} = C{i}({inputs})")
                made.append((f"c{i}", "mood"))
            case _:
                lines.append(f"stream out{i} = {terms[0][0]}")
    return draw(st.sampled_from(["\n", " ", " # note\n", "\n// note\n"])).join(lines)


def _check(text: str) -> tuple[tuple[CheckedDeclaration, ...], Signature]:
    return check_kpl(parse_kpl(text), text)


@settings(deadline=None, max_examples=100)
@given(specifications(), units)
def test_a_printed_specification_says_the_same(text: str, unit: str) -> None:
    declared, there = _check(text)
    printed = format_kpl(declared, unit)
    assert _check(printed)[0] == declared
    # One by one is the same as all at once.
    grown = Signature()
    for declaration in declared:
        line = format_kpl(declaration)
        new, grown = check_kpl(parse_kpl(line), line, None, grown)
        assert new == (declaration,)
    assert grown == there


@settings(deadline=None, max_examples=60)
@given(specifications(), st.data())
def test_what_is_left_without_a_declaration_stands(text: str, data: st.DataObject) -> None:
    declared, there = _check(text)
    key = data.draw(st.sampled_from([declaration.key for declaration in declared]))
    left = there.without([*there.dependents(key), key])
    again = format_kpl(left.declarations)
    assert _check(again)[1] == left


@settings(deadline=None, max_examples=150)
@given(specifications(), st.data())
def test_every_refusal_has_a_place(text: str, data: st.DataObject) -> None:
    """A text with a piece torn out or put in is read, or refused with a caret inside of it."""
    start = data.draw(st.integers(0, len(text)))
    end = data.draw(st.integers(start, min(len(text), start + 8)))
    extra = data.draw(
        st.sampled_from(["", "with", " any ", "[", ")", ";", "oo", "-1", "é", "\x00"])
    )
    torn = text[:start] + extra + text[end:]
    error = None
    try:
        _check(torn)
    except LanguageError as refusal:
        error = refusal
    if error is not None:
        assert 0 <= error.span.start <= error.span.end <= len(torn)
        assert "^" in error.render()
