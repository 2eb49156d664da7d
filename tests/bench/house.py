"""How large the source is, and how much of it a reader meets before the algorithm.

Run as `python3 tests/bench/house.py [-v] [CHECKOUT [OTHER]]`: the figures of a checkout (this one without
an argument), or of two beside each other. `-v` lists what is counted by name. How each figure is counted
stands at its function. The reading of Rust is a lexer's: macros that make items hide them.
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
    """A file of Rust, without its tests: as code, and its doc comments."""

    path: str
    text: str
    # No comments; strings are kept in `code` and emptied in `bare`, so that braces in them don't count.
    code: str = ""
    bare: str = ""
    docs: list[str] = field(default_factory=list)


@dataclass
class House:
    """Everything that is counted."""

    root: Path
    sources: list[Source]
    test_sources: list[Source]

    def matches(self, pattern: re.Pattern[str]) -> list[tuple[str, re.Match[str]]]:
        """Every match in code without comments, strings and tests, with its file."""
        return [(s.path, m) for s in self.sources for m in pattern.finditer(s.bare)]

    def options(self) -> dict[str, list[tuple[str, str]]]:
        """The public fields of each `…Options` struct, with their types."""
        found = {}
        for _, match in self.matches(OPTIONS):
            body = match.string[match.end() : closing(match.string, match.end() - 1)]
            found[match[2]] = (MACRO_FIELD if match[1] else FIELD).findall(body)
        return found


def closing(bare: str, opening: int) -> int:
    """The place of the brace that closes the one at `opening`."""
    depth = 0
    for match in re.compile(r"[{}]").finditer(bare, opening):
        depth += 1 if match[0] == "{" else -1
        if depth == 0:
            return match.start()
    return len(bare)


def end_of_comment(text: str, at: int) -> int:
    """Where the block comment ends that opens at `at`; they nest."""
    depth = 0
    for match in re.compile(r"/\*|\*/").finditer(text, at):
        depth += 1 if match[0] == "/*" else -1
        if depth == 0:
            return match.end()
    return len(text)


def lexed(path: str, text: str) -> Source:
    """The file with comments and tests removed. `code` and `bare` have the same length."""
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
    """The files that this one declares as modules of tests."""
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
    """All of `src`."""
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
    """Lines that are not blank, comments or tests. A line of a string is one of code."""
    return sum(sizes(house).values())


def leaves(house: House) -> list[str]:
    """The fields of an options file, `stage.name`; options structs within are opened."""
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
    """Names of struct, enum, union, trait and a module's type alias, each with the files that define it."""
    names: dict[str, list[str]] = {}
    for path, match in house.matches(TYPE):
        names.setdefault(match[1] or match[2], []).append(path)
    return [
        f"{name}: {', '.join(paths)}"
        for name, paths in sorted(names.items())
        if len(paths) > 1
    ]


def renders(house: House) -> list[str]:
    """`pub`, `pub(crate)` and `pub(super)` functions with `Rendered` in the type that they return."""
    return [f"{path}: {match[1]}" for path, match in house.matches(RENDERS)]


def stores(house: House) -> list[str]:
    """Files whose code names a path below `.stlfr/`, or hashes by blake3."""
    return [s.path for s in house.sources if STORE.search(s.code)]


def essays(house: House) -> int:
    """Lines of doc comments with the words Larger, Smaller, or `larger:`, `smaller:`."""
    pattern = re.compile(r"\b(?:Larger|Smaller)\b|\b(?:larger|smaller):")
    return sum(bool(pattern.search(doc)) for s in house.sources for doc in s.docs)


def readme_words(house: House) -> int:
    """All words of the file, as `wc -w` counts them."""
    return len((house.root / "README.md").read_text().split())


def sizes(house: House) -> Counter[str]:
    """Lines of code of each module of the first level."""
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
    """Print the table, and the lists."""
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
