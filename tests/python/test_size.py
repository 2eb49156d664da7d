"""Python code stays readable: short functions with few arguments, in short files."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
from filming import ROOT

MAX_ARGUMENTS = 5
"""Besides `self` or `cls`. Larger, and calls are lists of values that nobody can read; smaller, and functions
need a class each for what they are given."""

MAX_FUNCTION_LINES = 60
"""With its signature and its documentation. Larger, and a function no longer fits a screen; smaller, and what is one
step is cut in two."""

MAX_FILE_LINES = 500
"""Larger, and a file holds several subjects; smaller, and one subject takes several files."""

SIGNATURES_OF_BLENDER = {"draw_item", "template_list"}
"""`UIList.draw_item` is called by Blender with its seven arguments. `template_list` stands in for the method of
Blender's `UILayout` that the panels call."""

Function = ast.FunctionDef | ast.AsyncFunctionDef


def problems_of(source: str) -> list[str]:
    """What in a file breaks the rules, each with its line."""
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
    """All of a file, those within classes and functions too."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, Function):
            yield node


def argument_count(function: Function) -> int:
    """All that a caller can give; `*rest` and `**named` count as one each."""
    given = function.args
    positional = [argument.arg for argument in (*given.posonlyargs, *given.args)]
    if positional[:1] in (["self"], ["cls"]):
        del positional[0]
    collecting = [argument for argument in (given.vararg, given.kwarg) if argument]
    return len(positional) + len(given.kwonlyargs) + len(collecting)


def python_files() -> list[Path]:
    """Of the extension, the scenes, the scripts and the tests."""
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
