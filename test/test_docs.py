"""What the documents name is there: modules, files, links, commands and their options."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import pytest

from spacearm_ident.cli.main import parser

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "spacearm_ident"
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "bench").glob("*.md")])
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]
SPAN = re.compile(r"`([^`\n]+)`")
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")


def prose(page: Path) -> str:
    """The text without code blocks."""
    return re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)


def anchors(page: Path) -> set[str]:
    """Names that headings get: lower case, words joined by hyphens, punctuation dropped."""
    headings = re.findall(r"^#+ (.+)$", prose(page), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def is_there(module: str) -> bool:
    """Whether a path that a page names leads somewhere: from the root, the package or the tests, or by name alone."""
    if "/" in module:
        return any(any(top.glob(module)) for top in (ROOT, PACKAGE))
    tops = ("spacearm_ident", "test", "bench", "docs", "launch")
    return (ROOT / module).is_file() or any(any((ROOT / top).rglob(module)) for top in tops)


def commands(page: Path) -> list[tuple[str, str]]:
    """(command, the words after it) of every `spacearm COMMAND ...` in a page, continued lines joined."""
    text = page.read_text(encoding="utf-8").replace("\\\n", " ")
    blocks = re.findall(r"^```(?:console|sh|bash)\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)
    lines = [line.split(" # ")[0] for block in blocks for line in block.splitlines()] + SPAN.findall(prose(page))
    return re.findall(r"(?:^|[\s/])spacearm ([a-z][a-z-]*)(?= |$)([^|;&\n]*)", "\n".join(lines))


def options_of(command: str) -> set[str]:
    """Every option of a command.

    Raises:
        KeyError: There is no such command.
    """
    group = next(action for action in parser()._actions if isinstance(action, argparse._SubParsersAction))
    return {option for action in group.choices[command]._actions for option in action.option_strings}


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_modules_and_tests_that_a_page_names_exist(page):
    named = {word for span in SPAN.findall(prose(page)) for word in span.split() if word.endswith(".py")}
    assert not {module for module in named if not is_there(module)}


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_links_lead_somewhere(page):
    broken = set()
    for link in LINK.findall(prose(page)):
        if re.match(r"[a-z]+:", link):
            continue
        file, _, anchor = link.partition("#")
        target = (page.parent / file).resolve() if file else page
        if not target.exists() or (anchor and anchor not in anchors(target)):
            broken.add(link)
    assert not broken


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_commands_in_a_page_are_ones_and_know_their_options(page):
    unknown = []
    for command, rest in commands(page):
        if command in {"node"}:  # what follows belongs to ROS
            continue
        known = options_of(command)
        unknown += [f"{command} {option}" for option in OPTION.findall(rest) if option not in known]
    assert not unknown


def test_options_of_the_table_in_the_readme_are_those_of_identify():
    rows = re.findall(r"^\| `(--[^`]+)` \|", (ROOT / "README.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert len(rows) > 5
    assert not {row.split()[0] for row in rows} - options_of("identify")


def test_every_page_can_be_reached_from_the_readme():
    seen, ahead = set(), [ROOT / "README.md"]
    while ahead:
        page = ahead.pop()
        if page in seen:
            continue
        seen.add(page)
        targets = [(page.parent / link.partition("#")[0]).resolve() for link in LINK.findall(prose(page))]
        ahead += [target for target in targets if target.suffix == ".md" and target.is_file()]
    assert not set(PAGES) - seen


def physics_rows() -> list[tuple[str, str]]:
    """(quantity, where) of every row of the tables in docs/physics.md that have such columns."""
    rows: list[tuple[str, str]] = []
    header: list[str] = []
    for line in (ROOT / "docs" / "physics.md").read_text(encoding="utf-8").splitlines():
        # A bar inside a cell is written \\|, as Markdown asks.
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        if cells and header and header[-1] == "where" and not line.startswith("|---"):
            rows.append((cells[0], cells[-1]))
        header = (header or cells) if cells else []
    return rows


def test_equations_stand_where_the_physics_page_says():
    rows = physics_rows()
    assert len(rows) > 40
    wrong = []
    for what, where in rows:
        words = SPAN.findall(where)
        files = [word for word in words if word.endswith(".py")]
        texts = [(PACKAGE / file).read_text(encoding="utf-8") for file in files if (PACKAGE / file).is_file()]
        defined = {name for text in texts for name in re.findall(r"^(?:class|def) (\w+)", text, flags=re.MULTILINE)}
        if len(texts) != len(files) or not files or not set(words) - set(files) <= defined:
            wrong.append(f"{what}: {where}")
    assert not wrong
