"""Write what pages take from the package's data: `python docs/generated.py`.

These are the sections of warnings in troubleshooting.md, the tables of keys and options in
study.md, and those of options in tune.md and excite.md.
"""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path
from textwrap import fill

from strainwave.commands import command_texts
from strainwave.domain.messages import catalogue
from strainwave.domain.steps import STEPS
from strainwave.domain.study import study_keys, study_options

HERE = Path(__file__).parent
_WIDTH = 120  # columns
_HEADINGS = {"position_servo": "### Servos without torque"}  # others are `## [table]`


def with_warnings(page: str) -> str:
    """The page with what the catalogue says of the warnings of each section."""
    sections = map(_renewed_section, re.split(r"(?m)^(?=## )", page))
    return "".join(sections).rstrip() + "\n"


def _renewed_section(text: str) -> str:
    """Text of a section, its warnings, the most serious first, and those of likely effects."""
    heading = text.split("\n", 1)[0].removeprefix("## ")
    entries = {code: e for code, e in catalogue().items() if e["section"] == heading}
    if not entries:
        return text
    head, *written = re.split(r"(?m)^(?=### )", text)
    parts = [head.rstrip()]
    for code, entry in entries.items():
        sentences = (
            f"*Observed.* {entry['observed']} *Meaning.* {entry['meaning']}"
            f" *What to do.* {entry['remedy']}"
        )
        body = fill(sentences, _WIDTH, break_long_words=False, break_on_hyphens=False)
        parts.append(f"### `{code}`\n{body}")
        parts += [entry["detail"]] if "detail" in entry else []
    parts += [part.rstrip() for part in written if "-likely`\n" in part]
    return "\n\n".join(parts) + "\n\n"


def with_study_keys(page: str) -> str:
    """The page with the tables of the keys of a study, and of its options."""
    for table in ("arm", "joint", "servo", "position_servo"):
        heading = _HEADINGS.get(table, rf"## \[+{table}\]")
        title = next(line for line in page.splitlines() if re.match(heading, line))
        head, title, rest = page.partition(f"{title}\n")
        rows = [
            f"| `{each.key}` | {each.unit} | {each.default} | {each.meaning} |"
            for each in study_keys()[table]
        ]
        page = head + title + _with_table(rest, "key | unit | default | meaning", rows)
    rows = [
        f"| `{kind}` | `{each.key}` | {each.unit} | {each.default} | {each.meaning} |"
        for kind in STEPS
        for each in study_keys()[kind]
    ]
    return _with_options(_with_table(page, "step | key | unit | default | meaning", rows))


def _with_options(page: str) -> str:
    rows = [
        f"| `{each.name}` | {each.default} | {each.meaning} {each.reason} |"
        for each in study_options()
    ]
    return _with_table(page, "stage, key | default | meaning, and reason of the default", rows)


def with_command(command: str, page: str) -> str:
    """The page with the table of the options of a command."""
    rows = [
        f"| `--{name}` | {text.get('unit', '')} | {text.get('value') or text.get('default', '')} |"
        f" {text['help']} |"
        for name, text in command_texts()[command].items()
    ]
    return _with_table(page, "option | unit | default | meaning", rows)


def _with_table(page: str, heads: str, rows: list[str]) -> str:
    head, heading, rest = page.partition(f"| {heads} |\n{'|---' * (heads.count('|') + 1)}|\n")
    return head + heading + "".join(f"{row}\n" for row in rows) + "\n" + rest.partition("\n\n")[2]


PAGES = {
    HERE / "troubleshooting.md": with_warnings,
    HERE / "study.md": with_study_keys,
    HERE / "tune.md": partial(with_command, "tune"),
    HERE / "excite.md": partial(with_command, "excite"),
}
"""Pages, and the function that renews the text of each."""

if __name__ == "__main__":
    for path, renew in PAGES.items():
        path.write_text(renew(path.read_text(encoding="utf-8")), encoding="utf-8")
