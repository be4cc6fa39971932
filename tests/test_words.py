"""The field's standard terms in everything a user reads: words that are not, and what to say."""

from __future__ import annotations

import ast
import json
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "python" / "strainwave"

RETIRED = {
    r"told|tells?|telling": "identify, estimate, show, say",
    r"foretells?|foretold|foresees?|foreseen": "predict",
    r"never saw": "validation data",
    r"what is left|what the model leaves": "residuals",
    r"com(?:es?|ing) home|came home": "converge",
    r"twist(?:s|ed|ing)?": "torsion; load the gear",
    r"replay(?:s|ed|ing)?": "apply the recorded input",
    r"richer": "score test, further effect",
    r"manieth": "every k-th",
    r"one a joint": "one per joint",
    r"misfits?": "objective",
    r"at rest": "at standstill",
    r"where (?:a|the|its|their) (?:joints?|links?) rings?": "resonance, anti-resonance",
    r"half of it, %": "95 % half-width [%]",
    r"bent curves?": "multi-slope curve",
}
"""Pattern -> what to say in its place; words in code (between backquotes) do not count."""
LIKE = re.compile("|".join(rf"\b(?:{each})\b" for each in RETIRED), re.IGNORECASE)
NAMES = re.compile(
    r"told|tells?|fore(?:told|tells?|seen|sees?)|misfits?|replay\w*|roughly|finely|loud|richer|cautions?"
    r"|twist(?:s|ed|ing)?|manieth|thinning|lengthening|onset|stiction",
    re.IGNORECASE,
)
"""Parts of names in code that are retired; a word in a comment is judged by `RETIRED`."""
PUBLISHED_NAMES = {"hysteresis_twist"}  # of parameters in result files

ALLOWED = {
    "defl deflection twist torsion": "words that a column's name may have",
}
CODE = re.compile(r"```.*?```|`[^`\n]*`|\$\$.*?\$\$", re.DOTALL)

TYPES = re.compile(r"^ *(?:[\w, ]+ : .*|[A-Z]\w+)$", re.MULTILINE)
"""Lines of a docstring that name an argument or a type."""


def pages() -> dict[str, str]:
    """Text of every page, without code; of the change log what is not released."""
    found = {"README.md": ROOT / "README.md", "CHANGELOG.md": ROOT / "CHANGELOG.md"}
    found |= {str(p.relative_to(ROOT)): p for p in sorted((ROOT / "docs").rglob("*.md"))}
    texts = {name: CODE.sub(" ", path.read_text()) for name, path in found.items()}
    texts["CHANGELOG.md"] = texts["CHANGELOG.md"].split("\n## ")[1]
    for path in sorted((ROOT / "docs").rglob("*.ipynb")):
        cells = json.loads(path.read_text())["cells"]
        words = ["".join(c["source"]) for c in cells if c["cell_type"] == "markdown"]
        texts[str(path.relative_to(ROOT))] = CODE.sub(" ", "\n".join(words))
    return texts


def strings(path: Path) -> Iterator[tuple[int, str]]:
    """Line and text of messages and of docstrings, but for those of private functions."""
    tree = ast.parse(path.read_text())
    skipped = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.ClassDef)
        and node.name.startswith("_")
        and isinstance(node.body[0], ast.Expr)
    }
    for node in ast.walk(tree):
        if not isinstance(node, ast.Constant) or not isinstance(node.value, str):
            continue
        if id(node) not in skipped and " " in node.value.strip():
            yield node.lineno, TYPES.sub("", CODE.sub(" ", node.value))


def retired(text: str) -> list[str]:
    return [] if text.strip() in ALLOWED else [found[0] for found in LIKE.finditer(text)]


@pytest.mark.parametrize(("page", "text"), pages().items(), ids=list(pages()))
def test_pages(page: str, text: str) -> None:
    assert retired(text) == [], f"{page}: see RETIRED for what to say"


def test_messages_and_docstrings() -> None:
    found = [
        f"{path.relative_to(PACKAGE)}:{line}: {word}"
        for path in sorted(PACKAGE.rglob("*.py"))
        for line, text in strings(path)
        for word in retired(text)
    ]
    assert found == []


def names_and_comments(path: Path) -> Iterator[tuple[int, str]]:
    """Line and text of each retired name or word in a module's code."""
    with path.open("rb") as file:
        for token in tokenize.tokenize(file.readline):
            if token.type == tokenize.COMMENT:
                for word in retired(CODE.sub(" ", token.string)):
                    yield token.start[0], word
            if token.type == tokenize.NAME and token.string not in PUBLISHED_NAMES:
                parts = re.sub(r"([a-z])([A-Z])", r"\1_\2", token.string).split("_")
                if any(NAMES.fullmatch(part) for part in parts):
                    yield token.start[0], token.string


def test_names_and_comments() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {word}"
        for folder in (PACKAGE, ROOT / "tests", ROOT / "benchmarks", ROOT / "examples")
        for path in sorted(folder.rglob("*.py"))
        if path != Path(__file__)
        for line, word in names_and_comments(path)
    ]
    assert found == []


def test_no_module_is_named_by_one() -> None:
    names = [path.stem for path in PACKAGE.rglob("*.py")]
    assert [name for name in names if retired(name.replace("_", " "))] == []


@pytest.mark.parametrize("text", ["it was told", "Foretells steps", "a record it never saw"])
def test_they_are_seen(text: str) -> None:
    assert retired(text)
    assert not retired(CODE.sub(" ", f"`{text}`"))
