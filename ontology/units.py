"""Units of measurement: products of powers, their dimensions and conversions ([Events14 §III.A]).

A unit is written ``km.h-1``, ``ft`` or ``no_unit`` (SPEC §3) and held as a tuple of powers. Pint
knows the names; it is asked once per pair of units. Angles are a dimension of their own here, so
that a track in degrees and a plain count contradict each other.
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
"""The name of the unit that people write as ``%``."""
POWERS: Final = "a unit is a product of powers: write `m.s-1` for m/s"


class UnitError(ValueError):
    """A unit that cannot be understood, or two units that measure different things."""


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
        """True if values need not be touched."""
        return self.factor == 1.0 and self.offset == 0.0

    def apply(self, values: NDArray[Any]) -> NDArray[Any]:
        """The values converted, same shape; the array itself if nothing is to be done.

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


# Names that the standard tables of aviation and SSL texts use, whatever pint's own reading is:
# pint knows ``celsius`` but not ``Celsius``, and no ``fpm``; the others are fixed here so that a
# new release of pint cannot change what a running system's annotations mean.
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
"""Of a unit; of the SI's derived ones none has more than five."""
_REMEMBERED: Final = 4096
"""Units, and pairs of them, of which pint may remember something."""
_FACTOR: Final = re.compile(r"\s*([A-Za-z]+)\s*([+-]?\s*[0-9]{1,9})?\s*")
_LARGEST_POWER: Final = 99


def parse_unit(text: str) -> Unit:
    """The unit written as ``km.h-1``, ``mi,h-1``, ``ft`` or ``no_unit``; brackets may stand around.

    Raises `UnitError` for a text of another form and for a name that is no known unit.
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
    """The text of a unit, ``km.h-1``. Law: ``parse_unit(format_unit(u)) == u`` for known units."""
    if not unit:
        return NO_UNIT_TEXT
    return ".".join(f.name if f.power == 1 else f"{f.name}{f.power}" for f in unit)


@lru_cache(maxsize=4096)
def dimension(unit: Unit) -> str:
    """What a unit measures, as ``[length] / [time]`` or ``dimensionless``.

    Raises `UnitError` if a name is unknown or a power is 0 or beyond ±99.
    """
    if len(unit) > MOST_FACTORS:
        raise UnitError(f"a unit has at most {MOST_FACTORS} factors")
    with _lock:
        registry = _registry()
        powers = registry.get_dimensionality(_container(unit))
        _forget()
    above = [_power_text(name, power) for name, power in sorted(powers.items()) if power > 0]
    below = [_power_text(name, -power) for name, power in sorted(powers.items()) if power < 0]
    if not above and not below:
        return DIMENSIONLESS
    return " / ".join([" * ".join(above) or "1", *below])


def _power_text(name: str, power: Fraction) -> str:
    return name if power == 1 else f"{name} ** {power}"


@lru_cache(maxsize=4096)
def conversion(source: Unit, target: Unit) -> Conversion:
    """How values in ``source`` become values in ``target``; cached per pair.

    Temperatures on their own (power 1, nothing else) convert with their offset; in a product they
    are differences. Factors are computed exactly and rounded once. Raises `UnitError`, naming both
    units, if their dimensions differ or a scale is not linear (decibel).
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
            # Both are known and of one dimension, so the scale itself is the trouble.
            raise UnitError(
                f"no linear conversion from {format_unit(source)} to {format_unit(target)}"
            ) from error
        finally:
            _forget()
    if factor == 0.0 or not np.isfinite([factor, offset]).all():
        raise UnitError(
            f"the conversion from {format_unit(source)} to {format_unit(target)} "
            "is out of the range of numbers"
        )
    return Conversion(factor, offset)


_lock = threading.RLock()


@lru_cache(maxsize=1)
def _registry() -> Any:
    """Pint's tables with exact numbers, made on first use (about 0.1 s)."""
    # Definitions are loaded into an empty registry: pint's default constructor would precompute
    # dimensions before the radian is redefined.
    registry: Any = pint.UnitRegistry(None, non_int_type=Fraction, on_redefinition="ignore")
    registry.load_definitions(Path(pint.__file__).parent / "default_en.txt")
    for definition in _DEFINITIONS:
        registry.define(definition)
    return registry


_asked = count(1)


def _forget() -> None:
    """Called after each question: pint remembers every unit that it was ever asked for, some 2 KB
    each, so now and then its tables are made anew."""
    if next(_asked) % _REMEMBERED == 0:
        _registry.cache_clear()


def _container(unit: Unit) -> Any:
    """The unit in pint's names. Offset scales inside a product count as differences."""
    registry = _registry()
    powers: dict[str, int] = {}
    for factor in unit:
        if not 0 < abs(factor.power) <= _LARGEST_POWER:
            raise UnitError(
                f"the power of {factor.name} is {factor.power}; "
                f"it must be from 1 to {_LARGEST_POWER} or negative likewise"
            )
        name = _known_name(factor.name)
        powers[name] = powers.get(name, 0) + factor.power
    alone = len(unit) == 1 and unit[0].power == 1
    if not alone:
        powers = {_difference(name): power for name, power in powers.items()}
    return registry.UnitsContainer({name: power for name, power in powers.items() if power})


def _known_name(name: str) -> str:
    if not (name.isascii() and name.isalpha()):
        raise UnitError(f"{name!r} is no unit: a unit's name has letters only")
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
