"""Prints statistics of the source code: its size, and the numbers of options, constants, types and comments.

Run as `python3 tests/bench/house.py [-v] [CHECKOUT [OTHER]]`. It prints the statistics of one checkout (by default this
one), or of two side by side. `-v` also lists the counted items by name. The docstring of each function states what it
counts. Rust is only tokenized, not parsed, so items that macros generate are not counted.
"""

from __future__ import annotations

import argparse
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

TOKEN = re.compile(
    r"""
    (?P<doc>//[/!](?!/)[^\n]*) | (?P<line>//[^\n]*) | (?P<open>/\*)
  | (?P<raw>b?r(?P<hashes>\#*)".*?"(?P=hashes)) | (?P<string>b?"(?:\\.|[^"\\])*")
  | (?P<char>b?'(?:\\(?:x..|u\{[^}]*\}|.)|[^'\\])')
    """,
    re.VERBOSE | re.DOTALL,
)
TEST_ITEM = re.compile(r"#\[cfg\(test\)\]\s*")
TEST_FILE = re.compile(r"(?:pub(?:\([^)]*\))?\s+)?mod\s+(\w+)\s*;")
TYPE = re.compile(
    r"^[ \t]*(?:pub(?:\([^)]*\))?\s+)?(?:struct|enum|union|trait)\s+(\w+)"
    r"|^(?:pub(?:\([^)]*\))?\s+)?type\s+(\w+)",
    re.MULTILINE,
)
CONSTANT = re.compile(
    r"^[ \t]*(?:pub(?:\([^)]*\))?\s+)?(?:const|static)\s+[A-Z_]\w*\s*:", re.MULTILINE
)
# In the macro `options!` every field is public.
OPTIONS = re.compile(
    r"(options!\s*\{\s*(?:#\[[^\]]*\]\s*)*)?\bpub\s+struct\s+(\w*Options)\s*\{"
)
FIELD = re.compile(r"\bpub\s+(\w+)\s*:\s*([^,=\n]+)")
MACRO_FIELD = re.compile(r"^\s*(\w+)\s*:\s*([^,=\n]+)", re.MULTILINE)
RENDERS = re.compile(
    r"\bpub(?:\([^)]*\))?\s+fn\s+(\w+)[^{};]*?->([^{};]*\bRendered\b[^{};]*)[{;]"
)
STORE = re.compile(r'"\.stlfr/|blake3::')


@dataclass
class Source:
    """A Rust source file: its whole text, its code without comments and tests, and its doc comments."""

    path: str
    text: str
    # Both lack comments. `bare` also has blank string literals, so that braces in strings aren't counted.
    code: str = ""
    bare: str = ""
    docs: list[str] = field(default_factory=list)


@dataclass
class House:
    """All Rust sources of a checkout: those of the program, and those of tests."""

    root: Path
    sources: list[Source]
    test_sources: list[Source]

    def matches(self, pattern: re.Pattern[str]) -> list[tuple[str, re.Match[str]]]:
        """All matches of a pattern in code without comments, strings and tests, each with the path of its file."""
        return [(s.path, m) for s in self.sources for m in pattern.finditer(s.bare)]

    def options(self) -> dict[str, list[tuple[str, str]]]:
        """The public fields of each `…Options` struct, with their types, by the struct's name."""
        found = {}
        for _, match in self.matches(OPTIONS):
            body = match.string[match.end() : closing(match.string, match.end() - 1)]
            found[match[2]] = (MACRO_FIELD if match[1] else FIELD).findall(body)
        return found


def closing(bare: str, opening: int) -> int:
    """The position of the brace that closes the brace at the position `opening`; the text's length if there is none."""
    depth = 0
    for match in re.compile(r"[{}]").finditer(bare, opening):
        depth += 1 if match[0] == "{" else -1
        if depth == 0:
            return match.start()
    return len(bare)


def end_of_comment(text: str, at: int) -> int:
    """The position after the end of the block comment that starts at `at`; block comments may be nested."""
    depth = 0
    for match in re.compile(r"/\*|\*/").finditer(text, at):
        depth += 1 if match[0] == "/*" else -1
        if depth == 0:
            return match.end()
    return len(text)


def lexed(path: str, text: str) -> Source:
    """The source file with this text, with comments and tests removed. Its `code` and `bare` have equal lengths."""
    code, bare, docs, at = [], [], [], 0
    while match := TOKEN.search(text, at):
        between = text[at : match.start()]
        at = match.end()
        literal = match["raw"] or match["string"] or match["char"]
        if match["open"]:
            at = end_of_comment(text, match.start())
        elif match["doc"]:
            docs.append(match[0])
        blank = re.sub(r"[^\n]", "_", literal) if literal else ""
        code += [between, literal or ""]
        bare += [between, f'"{blank[1:-1]}"' if literal else ""]
    code.append(text[at:])
    bare.append(text[at:])
    source = Source(path, text, "".join(code), "".join(bare), docs)
    while match := TEST_ITEM.search(source.bare):
        end = re.compile(r"[{;]").search(source.bare, match.end())
        until = len(source.bare) if end is None else end.end()
        if end is not None and end[0] == "{":
            until = closing(source.bare, end.start()) + 1
        source.code = source.code[: match.start()] + source.code[until:]
        source.bare = source.bare[: match.start()] + source.bare[until:]
    return source


def test_files(path: Path, text: str) -> list[Path]:
    """The files that the file `path` declares as test modules (`#[cfg(test)] mod …;`)."""
    folder = (
        path.parent
        if path.name in ("mod.rs", "lib.rs", "main.rs")
        else path.with_suffix("")
    )
    names = [
        m[1] for t in TEST_ITEM.finditer(text) if (m := TEST_FILE.match(text, t.end()))
    ]
    return [
        file
        for n in names
        for file in (folder / f"{n}.rs", folder / n / "mod.rs")
        if file.exists()
    ]


def read(root: Path) -> House:
    """Read all Rust files in the folder `src` of a checkout."""
    texts = {path: path.read_text() for path in sorted((root / "src").rglob("*.rs"))}
    tests = {file for path, text in texts.items() for file in test_files(path, text)}
    folders = {file.parent for file in tests if file.name == "mod.rs"}
    house = House(root, [], [])
    for path, text in texts.items():
        is_test = path in tests or any(folder in path.parents for folder in folders)
        source = lexed(str(path.relative_to(root / "src")), text)
        (house.test_sources if is_test else house.sources).append(source)
    return house


def code_lines(house: House) -> int:
    """The number of lines of code: without blank lines, comments and tests. Lines inside strings are counted."""
    return sum(sizes(house).values())


def leaves(house: House) -> list[str]:
    """The names of all fields of an options file, as `stage.name`; fields of nested options structs are included."""
    structs = house.options()

    def below(prefix: str, struct: str) -> list[str]:
        found = []
        for name, kind in structs.get(struct, []):
            inner = re.search(r"\w*Options\b", kind)
            nested = inner is not None and inner[0] in structs
            found += (
                below(f"{prefix}{name}.", inner[0])
                if inner and nested
                else [prefix + name]
            )
        return found

    return below("", "RenderOptions")


def twice(house: House) -> list[str]:
    """The type names that are defined twice or more, each with the files that define it.

    Types are structs, enums, unions, traits, and type aliases of modules.
    """
    names: dict[str, list[str]] = {}
    for path, match in house.matches(TYPE):
        names.setdefault(match[1] or match[2], []).append(path)
    return [
        f"{name}: {', '.join(paths)}"
        for name, paths in sorted(names.items())
        if len(paths) > 1
    ]


def renders(house: House) -> list[str]:
    """The public functions, including `pub(crate)` and `pub(super)`, whose return type contains `Rendered`."""
    return [f"{path}: {match[1]}" for path, match in house.matches(RENDERS)]


def stores(house: House) -> list[str]:
    """The files whose code contains a path below `.stlfr/`, or uses the hash function blake3."""
    return [s.path for s in house.sources if STORE.search(s.code)]


def essays(house: House) -> int:
    """The number of lines of doc comments with the words `Larger`, `Smaller`, `larger:` or `smaller:`."""
    pattern = re.compile(r"\b(?:Larger|Smaller)\b|\b(?:larger|smaller):")
    return sum(bool(pattern.search(doc)) for s in house.sources for doc in s.docs)


def readme_words(house: House) -> int:
    """The number of words of README.md, as `wc -w` counts them."""
    return len((house.root / "README.md").read_text().split())


def sizes(house: House) -> Counter[str]:
    """The number of lines of code of each top-level module."""
    found: Counter[str] = Counter()
    for source in house.sources:
        module = source.path.split("/")[0].removesuffix(".rs")
        found[module] += sum(bool(line.strip()) for line in source.code.splitlines())
    return found


FIGURES: list[tuple[str, Callable[[House], int | list[str]]]] = [
    (
        "lines of src, all",
        lambda h: sum(len(s.text.splitlines()) for s in h.sources + h.test_sources),
    ),
    ("lines of code", code_lines),
    ("lines of doc comments", lambda h: sum(len(s.docs) for s in h.sources)),
    ("files of Rust", lambda h: len(h.sources + h.test_sources)),
    (
        "public fields of …Options structs",
        lambda h: sum(map(len, h.options().values())),
    ),
    ("options that an options file can set", leaves),
    ("constants and statics", lambda h: len(h.matches(CONSTANT))),
    ("lines that say what larger and smaller do", essays),
    ("type names defined twice or more", twice),
    ("functions that render a view", renders),
    ("files that store on disk or hash", stores),
    ("words of README.md", readme_words),
]


def main() -> None:
    """Print the table of statistics, and with `-v` the lists of counted items."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "checkouts", nargs="*", type=Path, default=[Path(__file__).resolve().parents[2]]
    )
    parser.add_argument(
        "-v", "--verbose", action="store_true", help="list what is counted by name"
    )
    options = parser.parse_args()
    houses = [read(root) for root in options.checkouts]
    found = {name: [count(house) for house in houses] for name, count in FIGURES}
    for name, values in found.items():
        print(
            f"{name:<44}"
            + "".join(f"{v if isinstance(v, int) else len(v):>9}" for v in values)
        )
    print("\nlines of code by module")
    modules = [sizes(house) for house in houses]
    for module in sorted(set().union(*modules), key=lambda m: -modules[0][m]):
        print(f"  {module:<42}" + "".join(f"{counts[module]:>9}" for counts in modules))
    if options.verbose:
        for name, values in found.items():
            for root, value in zip(options.checkouts, values, strict=True):
                if isinstance(value, list):
                    print(f"\n{name}, {root}")
                    print("\n".join(f"  {line}" for line in value))


if __name__ == "__main__":
    main()
