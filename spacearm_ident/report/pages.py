"""Pages out of templates: the environment that renders `templates/*.html`, and what templates may call.

Templates hold the structure and the fixed words of a page, Python the values. Whatever is put into a template is
escaped, unless it is `Markup`.
"""

from __future__ import annotations

import math
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING

from markupsafe import Markup, escape

from ..results.tables import shown_value
from . import text

if TYPE_CHECKING:
    from jinja2 import Environment


def render(template: str, **values: object) -> str:
    """A page, or a part of one, as HTML.

    Args:
        template: File name in `templates/`.
        values: What the template asks for, by name.

    Raises:
        jinja2.UndefinedError: The template asks for a value that is not there.
    """
    return environment().get_template(template).render(values)


def breakable(name: str) -> Markup:
    """A name that may go on in the next line after each underscore."""
    return escape(name).replace("_", Markup("_<wbr>"))


@cache
def environment() -> Environment:
    """The templates, with the filters and tests that they use; made once."""
    # Commands import this module whether or not they come to write a page.
    from jinja2 import Environment, PackageLoader, StrictUndefined

    made = Environment(
        loader=PackageLoader(__package__),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        auto_reload=False,
    )
    made.filters.update(
        breakable=breakable,
        capital=text.capital,
        correlation=text.correlation,
        interval=text.interval,
        listed=text.listed,
        measured=text.measured,
        minute=text.minute,
        number=text.number,
        percent=text.percent,
        quantity=text.quantity,
        shown_value=shown_value,
        unit=text.unit_text,
        whole_percent=text.whole_percent,
    )
    made.tests["finite"] = math.isfinite
    style_sheet = resources.files(__package__).joinpath("page.css").read_text(encoding="utf-8")
    made.globals["style_sheet"] = Markup(style_sheet)
    return made
