"""Decisions read values: regular expressions and affixes of text belong to readers and writers."""

from __future__ import annotations

import ast
from pathlib import Path

import strainwave

PACKAGE = Path(strainwave.__file__).parent
AFFIXES = {"startswith", "endswith", "removeprefix", "removesuffix"}
READERS = (
    "io/",
    "study_draft/",
    "campaign/",
    "errors.py",
    "monitoring/visits.py",
    "export/source.py",
    "workbench/study_edit.py",
    "workbench/workspace.py",
    "workbench/pages/by_hand.py",
    "workbench/pages/home.py",
)
"""Parse files, options and selection patterns."""
WRITERS = (
    "presentation/html.py",
    "presentation/report/",
    "export/flat.py",
    "experiment_design/written.py",
    "virtual/experiments.py",
    "workbench/pages/study.py",
)
"""Typeset names and sentences, make plain text of Markdown, and make file names."""
SENDERS = (
    "cli.py",
    "presentation/",
    "io/results.py",
    "experiment_design/",
    "study_draft/",
    "api.py",
    "workbench/pages/runs.py",
)
"""Show or write the messages of warnings."""


def modules() -> list[tuple[str, ast.Module]]:
    paths = sorted(PACKAGE.rglob("*.py"))
    return [
        (path.relative_to(PACKAGE).as_posix(), ast.parse(path.read_text(encoding="utf-8")))
        for path in paths
    ]


def test_no_other_module_uses_regular_expressions_or_affixes() -> None:
    found = set()
    for name, tree in modules():
        for node in ast.walk(tree):
            is_re = isinstance(node, ast.Import) and any(a.name == "re" for a in node.names)
            is_affix = isinstance(node, ast.Attribute) and node.attr in AFFIXES
            if (is_re or is_affix) and not name.startswith((*READERS, *WRITERS)):
                found.add(name)
    assert not found


def test_no_stage_reads_the_text_of_a_warning_or_a_suspicion() -> None:
    found = set()
    for name, tree in modules():
        names = {
            node.value.id
            for node in ast.walk(tree)
            if isinstance(node, ast.Attribute)
            and node.attr in ("message", "observation", "where", "remedy")
            and isinstance(node.value, ast.Name)
        }
        is_text = names & {"w", "warning", "diagnostic", "suspicion", "cause", "defect"}
        if is_text and not name.startswith(SENDERS):
            found.add(name)
    assert not found
