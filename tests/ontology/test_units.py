"""Units: names of aviation, products of powers, exact factors, errors that name both sides."""

import numpy as np
import pytest

from dyknow.ontology import units
from dyknow.ontology.units import (
    MOST_FACTORS,
    Conversion,
    UnitError,
    UnitPower,
    conversion,
    dimension,
    format_unit,
    parse_unit,
)


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("km.h-1", (UnitPower("km"), UnitPower("h", -1))),
        ("mi,h-1", (UnitPower("mi"), UnitPower("h", -1))),
        ("[ft]", (UnitPower("ft"),)),
        ("m+2", (UnitPower("m", 2),)),
        ("no_unit", ()),
    ],
)
def test_a_text_is_read(text: str, unit: object) -> None:
    assert parse_unit(text) == unit


@pytest.mark.parametrize("text", ["km.h-1", "ft", "kt", "deg", "no_unit", "m.s-2", "Celsius"])
def test_format_is_the_inverse_of_parse(text: str) -> None:
    assert format_unit(parse_unit(text)) == text


@pytest.mark.parametrize(
    ("source", "target", "factor", "offset"),
    [
        ("kt", "km.h-1", 1.852, 0.0),
        ("mi.h-1", "km.h-1", 1.609344, 0.0),
        ("ft", "m", 0.3048, 0.0),
        ("nmi", "m", 1852.0, 0.0),
        ("NM", "km", 1.852, 0.0),
        ("ft.min-1", "m.s-1", 0.00508, 0.0),
        ("fpm", "ft.min-1", 1.0, 0.0),
        ("FL", "ft", 100.0, 0.0),
        ("h", "min", 60.0, 0.0),
        ("min", "s", 60.0, 0.0),
        ("deg", "rad", np.pi / 180, 0.0),
        ("g", "kg", 0.001, 0.0),
        ("Celsius", "Fahrenheit", 1.8, 32.0),
        ("Celsius", "K", 1.0, 273.15),
        ("Celsius.h-1", "Fahrenheit.h-1", 1.8, 0.0),
        ("m.m-1", "no_unit", 1.0, 0.0),
    ],
)
def test_factors_are_exact(source: str, target: str, factor: float, offset: float) -> None:
    assert conversion(parse_unit(source), parse_unit(target)) == Conversion(factor, offset)


def test_conversions_are_cached() -> None:
    pair = parse_unit("kt"), parse_unit("m.s-1")
    assert conversion(*pair) is conversion(*pair)


def test_apply() -> None:
    celsius = np.array([0.0, 100.0])
    heat = conversion(parse_unit("Celsius"), parse_unit("Fahrenheit"))
    assert heat.apply(celsius).tolist() == [32.0, 212.0]
    same = conversion(parse_unit("kt"), parse_unit("kt"))
    assert same.is_identity
    assert same.apply(celsius) is celsius


@pytest.mark.parametrize(
    ("text", "what"),
    [("kt", "[length] / [time]"), ("deg", "[angle]"), ("no_unit", "dimensionless")],
)
def test_dimension(text: str, what: str) -> None:
    assert dimension(parse_unit(text)) == what


@pytest.mark.parametrize(
    "text", ["", "foo", "km0", "km.", "h1x", "km999", "km..h", "ft m", "k_m", "m99999999999"]
)
def test_a_bad_text_is_refused(text: str) -> None:
    with pytest.raises(UnitError):
        parse_unit(text)


@pytest.mark.parametrize(
    ("source", "target"), [("kt", "ft"), ("deg", "no_unit"), ("ft", "no_unit"), ("s", "m")]
)
def test_contradicting_dimensions_name_both_units(source: str, target: str) -> None:
    with pytest.raises(UnitError) as refusal:
        conversion(parse_unit(source), parse_unit(target))
    message = str(refusal.value)
    assert source in message
    assert target in message
    assert dimension(parse_unit(source)) in message
    assert dimension(parse_unit(target)) in message


def test_an_unknown_unit_is_named_with_a_hint() -> None:
    with pytest.raises(UnitError, match=r"'knoot'.*knot"):
        parse_unit("knoot")


def test_a_scale_that_is_not_linear_is_refused() -> None:
    with pytest.raises(UnitError, match="no linear conversion"):
        conversion(parse_unit("dB"), parse_unit("no_unit"))


def test_a_unit_has_a_bound() -> None:
    assert len(parse_unit(".".join(["m"] * MOST_FACTORS))) == MOST_FACTORS
    with pytest.raises(UnitError, match="a unit has at most 16 factors"):
        parse_unit(".".join(["m"] * (MOST_FACTORS + 1)))
    with pytest.raises(UnitError, match="a unit has at most 16 factors"):
        dimension((UnitPower("m"),) * (MOST_FACTORS + 1))


def test_units_that_nobody_names_again_are_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(units, "_CACHED_CALLS", 20)
    before = units._registry()
    for power in range(2, 90):
        square = parse_unit(f"km{power}.ft3")
        factor = conversion(square, parse_unit(f"m{power}.ft3")).factor
        assert factor == float(10 ** (3 * power))
    assert units._registry() is not before
    assert len(units._registry()._cache.dimensionality) < 100
