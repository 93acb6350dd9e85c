"""Units of measurement: products of powers, their dimensions and conversions ([Events14 §III.A]).

A unit is written ``km.h-1``, ``ft`` or ``no_unit`` (SPEC §3) and stored as a tuple of powers. Pint
knows the names; it is called once for each pair of units. Angles have a dimension of their own
here, so that a track in degrees and a plain count are incompatible.
"""

from __future__ import annotations

import difflib
import re
import threading
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from itertools import count
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
import pint
from numpy.typing import NDArray

NO_UNIT_TEXT: Final = "no_unit"
DIMENSIONLESS: Final = "dimensionless"
PERCENT: Final = "percent"
"""The name of the unit ``%``."""
POWERS: Final = "a unit is a product of powers: write `m.s-1` for m/s"


class UnitError(ValueError):
    """An unknown or malformed unit, or two units with different dimensions."""


@dataclass(frozen=True, slots=True)
class UnitPower:
    """One factor of a unit: ``mi`` is power 1, ``h-1`` is power -1."""

    name: str
    power: int = 1


Unit: TypeAlias = tuple[UnitPower, ...]
"""A product of powers; the empty product is ``no_unit``."""

NO_UNIT: Final[Unit] = ()


@dataclass(frozen=True, slots=True)
class Conversion:
    """``to = value * factor + offset``. The offset is 0 except between temperature scales."""

    factor: float
    offset: float = 0.0

    @property
    def is_identity(self) -> bool:
        """True if values stay unchanged."""
        return self.factor == 1.0 and self.offset == 0.0

    def apply(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the converted values, same shape; the array itself for the identity.

        Integers become float64 unless the conversion is the identity.
        """
        if self.is_identity:
            return values
        converted: NDArray[Any] = values * np.float64(self.factor)
        if self.offset != 0.0:
            converted += self.offset
        return converted


IDENTITY: Final = Conversion(1.0)
"""No change."""


# Names of the aviation tables and of SSL texts. Pint knows ``celsius`` but not ``Celsius``, and no
# ``fpm``. The others are fixed here, so that a new release of pint cannot change the meaning of
# existing annotations.
_NAMES: Final[dict[str, str]] = {
    "kt": "knot",
    "kn": "knot",
    "kts": "knot",
    "ft": "foot",
    "mi": "mile",
    "nmi": "nautical_mile",
    "NM": "nautical_mile",
    "min": "minute",
    "h": "hour",
    "hr": "hour",
    "s": "second",
    "sec": "second",
    "ms": "millisecond",
    "d": "day",
    "m": "meter",
    "km": "kilometer",
    "g": "gram",
    "kg": "kilogram",
    "t": "metric_ton",
    "deg": "degree",
    "rad": "radian",
    "Celsius": "degree_Celsius",
    "Fahrenheit": "degree_Fahrenheit",
    "Kelvin": "kelvin",
    "K": "kelvin",
    "FL": "flight_level",
    "fpm": "foot_per_minute",
}

_DEFINITIONS: Final = (
    "radian = [angle] = rad",
    "foot_per_minute = foot / minute",
    "flight_level = 100 * foot",
)

MOST_FACTORS: Final = 16
"""The greatest number of factors of a unit; no derived SI unit has more than five."""
_CACHED_CALLS: Final = 4096
"""The number of calls after which pint's tables are rebuilt, which empties its caches."""
_FACTOR: Final = re.compile(r"\s*([A-Za-z]+)\s*([+-]?\s*[0-9]{1,9})?\s*")
_LARGEST_POWER: Final = 99


def parse_unit(text: str) -> Unit:
    """Parse ``km.h-1``, ``mi,h-1``, ``ft`` or ``no_unit``, optionally in brackets.

    Raises `UnitError` for a malformed text and for an unknown name.
    """
    stripped = text.strip()
    if stripped == NO_UNIT_TEXT:
        return NO_UNIT
    if stripped.startswith("[") and stripped.endswith("]"):
        stripped = stripped[1:-1]
    factors = []
    if stripped.count(".") + stripped.count(",") >= MOST_FACTORS:
        raise UnitError(f"a unit has at most {MOST_FACTORS} factors")
    for part in re.split(r"[.,]", stripped):
        match = _FACTOR.fullmatch(part)
        if match is None and part == "%":
            raise UnitError(f"a unit is a name: write {PERCENT} for %")
        if match is None and "/" in part:
            raise UnitError(f"cannot read {text!r}: {POWERS}")
        if match is None:
            raise UnitError(
                f"cannot read {text!r} as a unit: write factors like km.h-1 "
                f"(a name of letters, then a power), or {NO_UNIT_TEXT}"
            )
        power = 1 if match[2] is None else int(match[2].replace(" ", ""))
        factors.append(UnitPower(match[1], power))
    unit = tuple(factors)
    dimension(unit)
    return unit


def format_unit(unit: Unit) -> str:
    """Return the text of a unit, ``km.h-1``. Law: ``parse_unit(format_unit(u)) == u`` for known
    units."""
    if not unit:
        return NO_UNIT_TEXT
    return ".".join(f.name if f.power == 1 else f"{f.name}{f.power}" for f in unit)


def is_unit(text: str) -> bool:
    """Whether a text is the name of a known unit, or a product of such."""
    try:
        return bool(parse_unit(text))
    except UnitError:
        return False


@lru_cache(maxsize=4096)
def dimension(unit: Unit) -> str:
    """Return the dimension of a unit, as ``[length] / [time]`` or ``dimensionless``.

    Raises `UnitError` for an unknown name, and for a power of 0 or beyond ±99.
    """
    if len(unit) > MOST_FACTORS:
        raise UnitError(f"a unit has at most {MOST_FACTORS} factors")
    with _lock:
        registry = _registry()
        powers = registry.get_dimensionality(_container(unit))
        _limit_cache()
    above = [_power_text(name, power) for name, power in sorted(powers.items()) if power > 0]
    below = [_power_text(name, -power) for name, power in sorted(powers.items()) if power < 0]
    if not above and not below:
        return DIMENSIONLESS
    return " / ".join([" * ".join(above) or "1", *below])


def _power_text(name: str, power: Fraction) -> str:
    return name if power == 1 else f"{name} ** {power}"


@lru_cache(maxsize=4096)
def conversion(source: Unit, target: Unit) -> Conversion:
    """Return the conversion from ``source`` to ``target``; cached for each pair.

    Temperatures on their own (power 1, nothing else) convert with their offset; in a product they
    are differences. Factors are computed exactly and rounded once. Raises `UnitError`, naming both
    units, for different dimensions and for a nonlinear scale (decibel).
    """
    if dimension(source) != dimension(target):
        raise UnitError(
            f"{format_unit(source)} measures {dimension(source)}, "
            f"but {format_unit(target)} measures {dimension(target)}"
        )
    with _lock:
        registry = _registry()
        first, second = _container(source), _container(target)
        if first == second:
            return Conversion(1.0)
        try:
            zero = registry.convert(Fraction(0), first, second)
            one = registry.convert(Fraction(1), first, second)
            factor, offset = float(one - zero), float(zero)
        except (pint.PintError, ArithmeticError, ValueError, TypeError) as error:
            # Both units are known and of one dimension, so the scale itself is nonlinear.
            raise UnitError(
                f"no linear conversion from {format_unit(source)} to {format_unit(target)}"
            ) from error
        finally:
            _limit_cache()
    if factor == 0.0 or not np.isfinite([factor, offset]).all():
        raise UnitError(
            f"the conversion from {format_unit(source)} to {format_unit(target)} "
            "is out of the range of numbers"
        )
    return Conversion(factor, offset)


_lock = threading.RLock()


@lru_cache(maxsize=1)
def _registry() -> Any:
    """Return pint's tables with exact numbers, built on first use (about 0.1 s)."""
    # Loads the definitions into an empty registry: the default constructor would compute dimensions
    # before the radian is redefined.
    registry: Any = pint.UnitRegistry(None, non_int_type=Fraction, on_redefinition="ignore")
    registry.load_definitions(Path(pint.__file__).parent / "default_en.txt")
    for definition in _DEFINITIONS:
        registry.define(definition)
    return registry


_calls = count(1)


def _limit_cache() -> None:
    """Rebuild pint's tables now and then: pint caches each unit that it was ever given, some 2 KB
    each. Called after each use."""
    if next(_calls) % _CACHED_CALLS == 0:
        _registry.cache_clear()


def _container(unit: Unit) -> Any:
    """Return the unit in pint's names. Scales with an offset count as differences in a product."""
    registry = _registry()
    powers: dict[str, int] = {}
    for factor in unit:
        if not 0 < abs(factor.power) <= _LARGEST_POWER:
            raise UnitError(
                f"the power of {factor.name} is {factor.power}; "
                f"it must be from 1 to {_LARGEST_POWER} or from -{_LARGEST_POWER} to -1"
            )
        name = _known_name(factor.name)
        powers[name] = powers.get(name, 0) + factor.power
    alone = len(unit) == 1 and unit[0].power == 1
    if not alone:
        powers = {_difference(name): power for name, power in powers.items()}
    return registry.UnitsContainer({name: power for name, power in powers.items() if power})


def _known_name(name: str) -> str:
    if not (name.isascii() and name.isalpha()):
        raise UnitError(f"{name!r} is not a unit: the name of a unit consists of letters")
    try:
        return str(_registry().get_name(_NAMES.get(name, name)))
    except pint.UndefinedUnitError:
        close = difflib.get_close_matches(name, [*_NAMES, *_NAMES.values()], n=3)
        hint = f"did you mean {' or '.join(close)}?" if close else "known are km, ft, kt, deg, h …"
        raise UnitError(f"unknown unit {name!r}; {hint}") from None


def _difference(name: str) -> str:
    registry = _registry()
    scale = registry._units[name].converter
    return f"delta_{name}" if getattr(scale, "offset", 0) else name
