"""Jobs whose .blend file was closed: what happens at their end without their operator, tested in this process."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from filming import errors, rig_camera, rig_content

folders = importlib.import_module("stlfr_extension.filming")
jobs = importlib.import_module("stlfr_extension.jobs")
long_work = importlib.import_module("stlfr_extension.long_work")


@pytest.fixture(autouse=True)
def _nothing_said() -> Iterator[None]:
    jobs.ended.clear()
    yield
    jobs.end_all()
    jobs.ended.clear()
    long_work._followed.clear()


def ended_job(code: str) -> Any:
    job = jobs.Job("Filming", [sys.executable, "-I", "-c", code])
    job.wait()
    return job


def begun(folder: Path) -> Path:
    """A folder in which filming was prepared, but nothing was filmed yet."""
    options = folders.Options("mine", 1, 1, False, 0, 1)
    blend = folders.begin(folder, rig_content(rig_camera("cam0")), options)
    blend.write_bytes(b"")
    return folder


def never() -> None:
    raise AssertionError("it isn't asked for")


def test_a_film_that_is_refused_leaves_no_folder(tmp_path: Path) -> None:
    """The folder is removed, so that filming can begin there again."""
    film = begun(tmp_path / "film")
    followed = long_work.Followed(
        ended_job("raise SystemExit('the rig has no views')"),
        lambda _: never(),
        lambda: folders.tidy(film),
    )
    long_work.conclude(followed)
    assert jobs.ended == ["Filming failed: the rig has no views"]
    assert not film.exists()


def test_a_film_that_is_cancelled_leaves_no_folder(tmp_path: Path) -> None:
    film = begun(tmp_path / "film")
    job = jobs.Job(
        "Filming", [sys.executable, "-I", "-c", "import time; time.sleep(60)"]
    )
    job.cancel()
    long_work.conclude(
        long_work.Followed(job, lambda _: never(), lambda: folders.tidy(film))
    )
    assert not jobs.ended and not film.exists()


@pytest.mark.parametrize(
    "error", [errors.BadInputError("mine"), KeyError("mine"), ValueError("mine")]
)
def test_an_error_after_the_end_is_said_and_the_timer_ends_in_order(
    error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After any error, the status bar's text is restored, and the next job is followed."""
    hidden: list[bool] = []
    monkeypatch.setattr(long_work, "hide_progress", lambda: hidden.append(True))

    def fail(_job: Any) -> str:
        raise error

    job = ended_job("pass")
    second = long_work.Followed(job, lambda _: "The second is done", never)
    long_work._followed.extend([long_work.Followed(job, fail, never), second])
    assert long_work._follow() is None
    assert [("mine" in said) for said in jobs.ended] == [True, False]
    assert jobs.ended[1] == "The second is done"
    assert hidden and not long_work._followed


def test_what_is_still_running_is_followed_on() -> None:
    job = jobs.Job(
        "Filming", [sys.executable, "-I", "-c", "import time; time.sleep(60)"]
    )
    long_work._followed.append(long_work.Followed(job, lambda _: "done", lambda: None))
    assert long_work._follow() == long_work.POLL_S
    assert not jobs.ended
