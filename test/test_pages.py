"""Templates of the pages: all of them compile, a missing value is an error, and Jinja2 is imported only for a page."""

from __future__ import annotations

import subprocess
import sys

import jinja2
import pytest
from made_result import Page, arm, identification, identified_model, validation

from spacearm_ident.report.comparison import comparison_html
from spacearm_ident.report.pages import environment, render
from spacearm_ident.results.store import Result


def test_every_template_compiles() -> None:
    names = environment().list_templates()
    assert {"frame.html", "macros.html", "result.html"} <= set(names)
    for name in names:
        environment().get_template(name)


def test_a_value_that_a_template_lacks_is_an_error() -> None:
    with pytest.raises(jinja2.UndefinedError, match="'folder' is undefined"):
        render("index.html", entries=[], trends=[], mismatches=[])


def test_a_joint_of_any_name_breaks_no_comparison() -> None:
    small = arm("&lt;b&gt;&amp;&quot;", "slide")
    assert small.joint_names[0] == '<b>&"'
    result = Result(identification(identified_model(small)), validation(small.joint_names), "2025-01-31T12:05:00+00:00")
    page = Page(comparison_html(("<i>", "&amp;"), (result, result)))
    assert not {"b", "i"} & set(page.tags)
    words = "".join(page.words)
    assert words.count('<b>&"') >= 3 and words.count("<i>") >= 5 and words.count("&amp;") >= 5


def test_commands_import_jinja2_only_to_write_a_page() -> None:
    code = (
        "import sys\n"
        "from spacearm_ident.cli.main import main\n"
        "try:\n    main(['report', '--help'])\nexcept SystemExit:\n    pass\n"
        "assert 'spacearm_ident.report.pages' in sys.modules and 'jinja2' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
