"""Documents: every link leads to a file and a heading, and every file of this project that a command names exists."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from filming import ROOT

DOCUMENTS = sorted(
    [
        ROOT / "README.md",
        *(ROOT / "blender").rglob("*.md"),
        *(ROOT / "tests").rglob("*.md"),
    ]
)

CODE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")
HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)
NAMED = re.compile(
    r"(?<![\w./-])(?:tests|blender|rigs|\.ci)/[\w./-]*\.(?:py|rs|sh|json|toml|svg)(?![\w{])"
)
BENCHMARK = re.compile(r"cargo bench --bench ([\w-]+)")


def anchors(document: str) -> set[str]:
    """The anchors of a document's headings: lower case, punctuation left out, spaces as hyphens."""
    titles = HEADING.findall(CODE.sub("", document))
    return {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}


def broken_links(path: Path) -> list[str]:
    """The targets of the links in the document at `path` that lead to no file, or to no heading of it."""
    broken = []
    for target in LINK.findall(CODE.sub("", path.read_text())):
        if "://" in target:
            continue
        name, _, anchor = target.partition("#")
        file = path.parent / name if name else path
        if not file.exists() or (anchor and anchor not in anchors(file.read_text())):
            broken.append(target)
    return broken


def missing_files(path: Path) -> list[str]:
    """The benchmarks, and the files of this project, that the document at `path` names and that don't exist;
    capitals stand for a name."""
    text = path.read_text()
    named = [name for name in NAMED.findall(text) if not Path(name).stem.isupper()]
    files = [name for name in named if not (ROOT / name).exists()]
    benches = [f"tests/bench/{name}.rs" for name in BENCHMARK.findall(text)]
    return files + [name for name in benches if not (ROOT / name).exists()]


def test_broken_links_and_missing_files_are_found(tmp_path: Path) -> None:
    document = tmp_path / "a.md"
    document.write_text(
        "# A `title`, long\n\n[1](#a-title-long) [2](#other) [3](b.md) [4](https://a.b/c#d)\n"
        "```\n# no heading\ncargo bench --bench nothing\n```\n[5](#no-heading) `tests/bench/nothing.py`\n"
    )
    assert broken_links(document) == ["#other", "b.md", "#no-heading"]
    assert missing_files(document) == [
        "tests/bench/nothing.py",
        "tests/bench/nothing.rs",
    ]


@pytest.mark.parametrize(
    "path", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT))
)
def test_links_and_named_files_exist(path: Path) -> None:
    assert broken_links(path) == []
    assert missing_files(path) == []


def test_every_document_of_measurements_is_in_their_table_of_contents() -> None:
    folder = ROOT / "tests" / "bench"
    contents = (folder / "README.md").read_text()
    left_out = [
        path.name for path in folder.glob("*.md") if f"]({path.name}" not in contents
    ]
    assert left_out == ["README.md"]
