"""Numbers, units and lists of names as a person would write them."""

from __future__ import annotations

import math

MINUS = "\N{MINUS SIGN}"
NOTHING = "\N{EN DASH}"


def number(value: float, digits: int = 3) -> str:
    """A number with so many significant digits, a real minus, and a dash for NaN.

    Args:
        value: To print.
        digits: Significant digits.
    """
    if not math.isfinite(value):
        return NOTHING
    if value == 0.0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    if -4 <= exponent < 6:
        # Rounding first: 9.9996 has one digit more before the point once it is rounded.
        exponent = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
        text = f"{value:.{max(0, digits - 1 - exponent)}f}"
    else:
        text = f"{value:.{digits - 1}e}"
    return _typeset(text)


def measured(value: float, error: float) -> str:
    """A value to the digits its standard error allows, `14.879 ± 0.021`; four digits without one.

    The error has one digit, or two where it begins below 3.5: the rule of the Particle Data Group.

    Args:
        value: To print.
        error: Its standard error, in the same unit; NaN where there is none.
    """
    if not (math.isfinite(error) and error > 0.0 and math.isfinite(value)):
        return number(value, 4)
    place = math.floor(math.log10(error))
    place -= error / 10.0**place < 3.5
    if place > 0 or place < -6:
        size = math.floor(math.log10(abs(value))) if value else place
        return f"{number(value, min(max(3, size - place + 1), 15))} ± {number(error, 2)}"
    decimals = -place
    # Adding zero makes a rounded negative zero positive.
    return _typeset(f"{round(value, decimals) + 0.0:.{decimals}f} ± {error:.{decimals}f}")


def percent(share: float) -> str:
    """A share as a percentage: `3.2 %`."""
    return f"{number(100 * share, 3 if share >= 0.1 else 2)} %" if math.isfinite(share) else NOTHING


def whole_percent(share: float) -> str:
    """A share as a percentage without decimals: `98 %`."""
    return f"{100 * share:.0f} %" if math.isfinite(share) else NOTHING


def quantity(value: float, unit: str, digits: int = 3) -> str:
    """A number with its unit, `1.23 N·m`; without one where the unit is `1` or empty.

    Args:
        value: To print.
        unit: As in results, `N m`.
        digits: Significant digits.
    """
    return f"{number(value, digits)} {unit_text(unit)}".rstrip()


def interval(ends: tuple[float, float], between: str = "to") -> str:
    """The ends of an interval to four digits, `0.9700 to 1.030`; a dash where an end is not known.

    Args:
        ends: Lower and upper; infinite or NaN where not known.
        between: Word between them.
    """
    low, high = ends
    known = math.isfinite(low) and math.isfinite(high)
    return f"{number(low, 4)} {between} {number(high, 4)}" if known else NOTHING


def correlation(value: float) -> str:
    """A correlation coefficient to four decimals."""
    return f"{value:.4f}" if math.isfinite(value) else NOTHING


def capital(words: str) -> str:
    """Words that begin with a capital letter; the rest of them as it is."""
    return f"{words[:1].upper()}{words[1:]}"


def minute(written: str) -> str:
    """`2025-01-31 12:05` of an ISO 8601 time."""
    return written[:16].replace("T", " ")


def _typeset(text: str) -> str:
    mantissa, _, exponent = text.partition("e")
    if exponent:
        text = f"{mantissa}×10{str(int(exponent)).translate(SUPERSCRIPT)}"
    return text.replace("-", MINUS)


SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def unit_text(unit: str) -> str:
    """A unit as printed: `kg m^2` becomes `kg·m²`, and `1` nothing."""
    return "" if unit == "1" else unit.replace(" ", "·").replace("^2", "²").replace("^3", "³")


def listed(names: list[str] | tuple[str, ...], most: int = 8) -> str:
    """Names for a sentence: `a, b and c`, or `a, b and 9 more`.

    Args:
        names: At least one.
        most: So many are named, the others counted.
    """
    shown = list(names) if len(names) <= most else [*names[: most - 1], f"{len(names) - most + 1} more"]
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} and {shown[-1]}" if shown else ""
