"""HTML that cannot be broken by the text in it, and numbers as a person would write them."""

from __future__ import annotations

import math
from html import escape

MINUS = "\N{MINUS SIGN}"
NOTHING = "\N{EN DASH}"


class Markup(str):
    """Text that is HTML already; every other string is escaped when it becomes part of an element."""


SCOPE = {"thead": "col", "tbody": "row"}
"""Part of a table -> what its header cells are the headers of, for readers of screens."""
VOID = frozenset({"col", "meta", "line", "circle", "rect", "path"})


def element(tag: str, *children: object, **attributes: object) -> Markup:
    """`<tag attributes>children</tag>`.

    Args:
        tag: Element name.
        children: Markup is taken as it is; anything else is turned into text and escaped; None is left out.
        attributes: A trailing underscore is dropped (`class_`), others become hyphens; None is left out.
    """
    named = "".join(
        f' {name.rstrip("_").replace("_", "-")}="{escape(str(value))}"'
        for name, value in attributes.items()
        if value is not None
    )
    if tag in VOID:
        return Markup(f"<{tag}{named}>" if tag in ("col", "meta") else f"<{tag}{named}/>")
    inside = join(*children)
    if tag in SCOPE:
        inside = Markup(
            inside.replace("<th>", f'<th scope="{SCOPE[tag]}">').replace("<th ", f'<th scope="{SCOPE[tag]}" ')
        )
    return Markup(f"<{tag}{named}>{inside}</{tag}>")


def join(*children: object) -> Markup:
    """Children one after the other, each escaped unless it is markup."""
    return Markup(
        "".join(child if isinstance(child, Markup) else escape(str(child)) for child in children if child is not None)
    )


def number(value: float, digits: int = 3) -> str:
    """A number with so many significant digits, a real minus, and a dash for NaN."""
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


def _typeset(text: str) -> str:
    mantissa, _, exponent = text.partition("e")
    if exponent:
        text = f"{mantissa}×10{str(int(exponent)).translate(_SUPERSCRIPT)}"
    return text.replace("-", MINUS)


_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def unit_text(unit: str) -> str:
    """A unit as printed: `kg m^2` becomes `kg·m²`, and `1` nothing."""
    return "" if unit == "1" else unit.replace(" ", "·").replace("^2", "²").replace("^3", "³")


def breakable(name: str) -> Markup:
    """A name that may go on in the next line after each underscore."""
    return Markup(join(name).replace("_", "_<wbr>"))


def listed(names: list[str] | tuple[str, ...], most: int = 8) -> str:
    """Names for a sentence: `a, b and c`, or `a, b and 9 more`."""
    shown = list(names) if len(names) <= most else [*names[: most - 1], f"{len(names) - most + 1} more"]
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} and {shown[-1]}" if shown else ""
