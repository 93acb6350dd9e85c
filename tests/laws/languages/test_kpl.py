"""Laws of KPL: what is printed says the same, and every refusal has its place."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dyknow.languages.errors import LanguageError
from dyknow.languages.kpl import (
    CheckedDeclaration,
    ForeachDeclaration,
    Label,
    Signature,
    check_kpl,
    format_kpl,
    format_policy,
    instantiate,
    parse_kpl,
    parse_label,
    parse_policy,
)
from dyknow.streams.policies.policy import (
    AnyChange,
    AnyUpdate,
    Approximation,
    ChangeBy,
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
by = st.floats(0, exclude_min=True, allow_infinity=False).map(ChangeBy)
periods = st.just(AnyChange()) | delays.filter(bool).map(SampleEvery)
changes = st.just(AnyUpdate()) | periods | by
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
    by = any(isinstance(p.change, ChangeBy) for p in (one, other))
    if len(periods) == 2 or (periods and by):
        with pytest.raises(
            LanguageError, match=r"two sample periods|`sample every` and `change by`"
        ):
            parse_policy(joined, "ns")
        return
    both = parse_policy(joined, "ns")
    turned = parse_policy(", ".join(filter(None, [more, text])), "ns")
    assert both == turned
    assert both.duration.first == max(one.duration.first, other.duration.first)
    assert both.duration.last == min(one.duration.last, other.duration.last)
    bounds = [p.max_delay for p in (one, other) if p.max_delay is not None]
    assert both.max_delay == min(bounds, default=None)


objects = st.sampled_from(["car1", "7", "to", "a b", "x:y", "7:y", '"', "\\", "é\n", ""])
texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=5)


@settings(deadline=None, max_examples=200)
@given(st.lists(objects | texts, max_size=3))
def test_a_printed_label_is_read_again(named: list[str]) -> None:
    label = Label("f", tuple(named))
    assert parse_label(str(label)) == label
    assert label.identifier.isidentifier()
    assert label.identifier.isascii()


@st.composite
def specifications(draw: st.DrawFn) -> str:
    """Texts that make sense: every name stands on what is declared."""
    sorts = ["float", "integer", "string", "mood", "pair"]
    lines = ["sort pair = (x float, y integer)", "source object o", "strmgen members = o"]
    made: list[tuple[str, str]] = []
    featured: list[tuple[str, str]] = []
    for i in range(draw(st.integers(1, 3))):
        sort = draw(st.sampled_from(sorts))
        lines.append(f"source {sort} s{i}")
        arity = draw(st.sampled_from(["", "[]", "[a]", "[a, every_b]"]))
        lines.append(f"strmgen f{i}{arity} = s{i}")
        made.append((f"f{i}{arity}", sort))
        for object in draw(st.lists(objects, max_size=2, unique=True)):
            label = str(Label(f"g{i}", (object,)))
            lines.append(f"strmgen {label} = s{i}")
            made.append((label, sort))
            featured.append((f"g{i}", sort))

    def with_policy(label: str) -> str:
        policy = format_policy(draw(policies()))
        return f"{label} with {policy}" if policy else label

    def term() -> tuple[str, str]:
        label, sort = draw(st.sampled_from(made))
        return with_policy(label), sort

    for i in range(draw(st.integers(0, 5))):
        terms = [term() for _ in range(draw(st.integers(1, 3)))]
        inputs = ", ".join(text for text, _ in terms)
        match draw(st.integers(0, 7)):
            case 0:
                lines.append(f"strmgen j{i} = join({inputs})")
                made.append((f"j{i}", f"j{i}"))
            case 1:
                values = [draw(st.just(AnyUpdate()) | periods), *map(draw, parts[1:])]
                policy = SynchronizationPolicy(*values, draw(st.sampled_from(Approximation)))
                text = format_policy(policy).replace(", ", draw(st.sampled_from([", ", "; "])))
                lines.append(f"strmgen y{i}[w] = sync({inputs}; {text})")
                made.append((f"y{i}[w]", f"y{i}"))
            case 2:
                lines.append(f"compunit mood C{i}({', '.join(sort for _, sort in terms)})")
                lines.append(f"strmgen c{i} = C{i}({inputs})")
                made.append((f"c{i}", "mood"))
            case 3:
                lines.append(f"sink k{i}({inputs})")
            case 4 if featured:
                feature, sort = draw(st.sampled_from(featured))
                name = draw(st.sampled_from(["aggregate", "select"]))
                mediated = f"{with_policy(f'{feature}[v]')} foreach v in {with_policy('members')}"
                lines.append(f"strmgen m{i} = {name}({mediated})")
                made.append((f"m{i}", sort))
            case 5:
                lines.append(f"strmgen x{i}[a] = selectObject({with_policy('members')})")
                made.append((f"x{i}[a]", "object"))
            case 6:
                lines.append(f"foreach u in {with_policy('members')} {{ strmgen h{i}[u] = s0")
                lines.append(f"strmgen p{i}[u] = join({with_policy(f'h{i}[u]')}, {inputs})")
                if featured:
                    feature, sort = draw(st.sampled_from(featured))
                    # The computational unit stands before the block.
                    lines.insert(len(lines) - 2, f"compunit mood D{i}({sort})")
                    lines.append(f"strmgen d{i}[u] = D{i}({with_policy(f'{feature}[u]')})")
                lines.append("}")
                featured.append((f"p{i}", f"p{i}"))
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
    gone = (*there.dependents(key), key)
    left = there.without(gone)
    again = format_kpl(left.declarations)
    assert _check(again)[1] == left
    # One after the other, users first, is the same as all at once.
    for each in gone:
        there = there.without([each])
    assert there == left


@settings(deadline=None, max_examples=60)
@given(specifications(), objects)
def test_an_instantiated_foreach_can_be_declared(text: str, object: str) -> None:
    """For an object that nobody has declared: its labels are new, and they are as the pattern."""
    _, there = _check(text)
    for foreach in [d for d in there.declarations if isinstance(d, ForeachDeclaration)]:
        made = instantiate(foreach, object)
        for generator, pattern in zip(made, foreach.generators, strict=True):
            assert generator.label == pattern.label.bound(foreach.variable, object)
            assert generator.sort == pattern.sort
        alone = made[0]
        line = format_kpl(alone)
        assert check_kpl(parse_kpl(line), line, None, there)[0] == (alone,)


@settings(deadline=None, max_examples=60)
@given(specifications(), st.data())
def test_a_text_in_two_parts_is_the_text(text: str, data: st.DataObject) -> None:
    """Added while the system runs or at once: the same; and again it changes nothing."""
    declared, there = _check(text)
    cut = data.draw(st.integers(0, len(declared)))
    first, second = format_kpl(declared[:cut]), format_kpl(declared[cut:])
    _, before = _check(first)
    new, after = check_kpl(parse_kpl(second), second, None, before)
    assert new == declared[cut:]
    assert after == there
    assert check_kpl(parse_kpl(text), text, None, there) == ((), there)
    # One bad declaration behind it, and nothing of it is there.
    bad = f"{second}\nstream nothing = nowhere"
    with pytest.raises(LanguageError, match="nowhere"):
        check_kpl(parse_kpl(bad), bad, None, before)
    assert before == _check(first)[1]


@settings(deadline=None, max_examples=150)
@given(specifications(), st.data())
def test_every_refusal_has_a_place(text: str, data: st.DataObject) -> None:
    """A text with a piece torn out or put in is read, or refused with a caret inside of it."""
    start = data.draw(st.integers(0, len(text)))
    end = data.draw(st.integers(start, min(len(text), start + 8)))
    extra = data.draw(
        st.sampled_from(
            [
                "",
                "with",
                " any ",
                "[",
                ")",
                ";",
                "oo",
                "-1",
                "é",
                "\x00",
                '"',
                "{",
                "}",
                " foreach ",
            ]
        )
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
