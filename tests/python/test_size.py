"""Limits of the size of Python code: arguments per function, lines per function, lines per file."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
from filming import ROOT

MAX_ARGUMENTS = 5
"""Maximum number of a function's arguments, without `self` or `cls`. If larger, calls are unreadable lists of values;
if smaller, many functions need a class for their arguments."""

MAX_FUNCTION_LINES = 60
"""Maximum number of lines of a function, with its signature and documentation. If larger, a function doesn't fit on a
screen; if smaller, single steps must be split."""

MAX_FILE_LINES = 500
"""Maximum number of lines of a file. If larger, a file has several subjects; if smaller, one subject needs several
files."""

SIGNATURES_OF_BLENDER = {"draw_item", "template_list"}
"""Methods that may have more arguments, because Blender defines them. Blender calls `UIList.draw_item` with seven
arguments. `template_list` is a fake of the method of Blender's `UILayout`."""

Function = ast.FunctionDef | ast.AsyncFunctionDef


def problems_of(source: str) -> list[str]:
    """The violations of the limits in a file's source, each with its line number."""
    lines = len(source.splitlines())
    found = []
    if lines > MAX_FILE_LINES:
        found.append(f"1: {lines} lines, more than {MAX_FILE_LINES}")
    for function in functions_of(source):
        where = f"{function.lineno}: {function.name}"
        assert function.end_lineno is not None
        length = function.end_lineno - function.lineno + 1
        if length > MAX_FUNCTION_LINES:
            found.append(f"{where} has {length} lines, more than {MAX_FUNCTION_LINES}")
        count = argument_count(function)
        if count > MAX_ARGUMENTS and function.name not in SIGNATURES_OF_BLENDER:
            found.append(f"{where} has {count} arguments, more than {MAX_ARGUMENTS}")
    return found


def functions_of(source: str) -> Iterator[Function]:
    """All functions in a file's source, including methods and nested functions."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, Function):
            yield node


def argument_count(function: Function) -> int:
    """The number of a function's arguments without `self` or `cls`; `*rest` and `**named` count as one each."""
    given = function.args
    positional = [argument.arg for argument in (*given.posonlyargs, *given.args)]
    if positional[:1] in (["self"], ["cls"]):
        del positional[0]
    collecting = [argument for argument in (given.vararg, given.kwarg) if argument]
    return len(positional) + len(given.kwonlyargs) + len(collecting)


def python_files() -> list[Path]:
    """The Python files of the extension, the scenes, the scripts and the tests."""
    files = [
        file for top in ("blender", "tests") for file in (ROOT / top).rglob("*.py")
    ]
    return sorted(file.relative_to(ROOT) for file in files)


def test_functions_and_files_are_small() -> None:
    files = python_files()
    assert Path("blender/stlfr/plan.py") in files
    assert Path("tests/python/test_size.py") in files
    found = [
        f"{file}:{problem}"
        for file in files
        for problem in problems_of((ROOT / file).read_text(encoding="utf-8"))
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("source", "problem"),
    [
        ("def f(a, b, c, d, e): ...", ""),
        ("def f(a, b, /, c, *, d, e, f): ...", "1: f has 6 arguments"),
        ("async def f(a, b, c, d, *e, **f): ...", "1: f has 6 arguments"),
        ("class A:\n def f(self, a, b, c, d, e): ...", ""),
        ("class A:\n def f(self, a, b, c, d, e, f): ...", "2: f has 6 arguments"),
        ("def f():\n def g(a, b, c, d, e, f): ...", "2: g has 6 arguments"),
        ("class A:\n def draw_item(self, a, b, c, d, e, f): ...", ""),
        ("def f():" + "\n pass" * 59, ""),
        ("def f():" + "\n pass" * 60, "1: f has 61 lines"),
        ("\n" * 500, ""),
        ("\n" * 501, "1: 501 lines"),
    ],
)
def test_what_is_too_large_is_found(source: str, problem: str) -> None:
    found = problems_of(source)
    assert len(found) == (1 if problem else 0)
    assert all(line.startswith(problem) for line in found)
