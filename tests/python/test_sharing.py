"""Filming one capture by several processes, on one machine or on several."""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from filming import CAPTURE_SCRIPT, by_script, rig_camera, right_of_centre, write_rig

sharing = importlib.import_module("stlfr_extension.sharing")

SMALL = ["--scene", "magazine", "--engine", "workbench", "--frames", "24"]
SMALL += ["--samples", "1", "--instants", "1"]
FILES = 54
"""Number of files of the capture: two cameras' frames, and ground truth images, depths and motions of one instant."""


@pytest.fixture(scope="module")
def small_rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rig file with two cameras, 6 cm apart, with an offset of 0.37 frame intervals."""
    return write_rig(
        tmp_path_factory.mktemp("rig") / "rig.json",
        rig_camera("left"),
        rig_camera("right", delay_s=0.37 / 30, cam_from_rig=right_of_centre(0.06)),
    )


@pytest.fixture(scope="module")
def by_one(small_rig: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The capture filmed by a single process."""
    folder = tmp_path_factory.mktemp("one") / "capture"
    result = by_script(small_rig, *SMALL, "--workers", 1, "-o", folder)
    assert result.returncode == 0, result.stderr
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    """The contents of all files of a folder except those of the plan, by path."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name != "plan.txt"
    }


def start(rig_file: Path, folder: Path, *more: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-I", CAPTURE_SCRIPT, rig_file, *SMALL, "--workers", 1]
    command += ["-o", folder, *more]
    return subprocess.Popen(
        [str(word) for word in command],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


class Watched:
    """Records every version of every image in a folder while it is being filmed into, to find images filmed twice."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.versions: defaultdict[str, set[tuple[int, int]]] = defaultdict(set)
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self.watch)
        self.thread.start()

    def watch(self) -> None:
        while not self.ended.wait(0.01):
            self.look()

    def look(self) -> None:
        for pattern in ("left/*", "right/*", "truth/views/*"):
            # Images may vanish at any time, when they are packed into a video.
            with contextlib.suppress(FileNotFoundError):
                for path in self.folder.glob(pattern):
                    status = path.stat()
                    version = (status.st_ino, status.st_mtime_ns)
                    self.versions[str(path.relative_to(self.folder))].add(version)

    def filmed_twice(self) -> list[str]:
        return [name for name, seen in self.versions.items() if len(seen) > 1]

    def end(self) -> None:
        self.ended.set()
        self.thread.join()
        self.look()


@pytest.fixture
def watched(tmp_path: Path) -> Iterator[Watched]:
    watched = Watched(tmp_path / "capture")
    yield watched
    watched.end()


def test_of_four_processes_three_are_killed(
    by_one: Path, small_rig: Path, tmp_path: Path, watched: Watched
) -> None:
    folder = tmp_path / "capture"
    seed = random.SystemRandom().randrange(1000)
    chance = random.Random(seed)
    processes = [start(small_rig, folder) for _ in range(4)]
    for victim in processes[:3]:
        count = len(watched.versions)
        goal = count + chance.randrange(1, 12)
        while len(watched.versions) < goal and victim.poll() is None:
            time.sleep(0.01)
        time.sleep(0.2 * chance.random())
        victim.kill()
        victim.communicate()
        print(f"seed {seed}: killed after {len(watched.versions)} of {FILES} files")
    _, complaint = processes[3].communicate(timeout=200)
    assert processes[3].returncode == 0, complaint
    watched.end()
    assert contents(folder) == contents(by_one)
    assert watched.filmed_twice() == []
    assert [path.name for path in (folder / ".film").iterdir()] == ["plan.txt"]


def test_four_processes_do_each_image_once_and_pack_each_video_once(
    small_rig: Path, tmp_path: Path, watched: Watched
) -> None:
    folder = tmp_path / "capture"
    processes = [start(small_rig, folder, "--video") for _ in range(4)]
    said = [process.communicate(timeout=200) for process in processes]
    assert [process.returncode for process in processes] == [0] * 4, said
    done = [json.loads(line)["what"] for out, _ in said for line in out.splitlines()]
    own = [what for what in done if what[0] in "lrt" and "elsewhere" not in what]
    assert len(own) == len(set(own)) == 54, own  # 52 images and geometries, 2 videos
    assert watched.filmed_twice() == []
    alone = by_script(small_rig, *SMALL, "--video", "-o", tmp_path / "alone")
    assert alone.returncode == 0, alone.stderr
    assert contents(folder) == contents(tmp_path / "alone")


def test_a_silent_process_is_replaced_after_the_silence(
    by_one: Path, small_rig: Path, tmp_path: Path
) -> None:
    """The silent process has claimed an image, has no heartbeat, and holds its lock, as on an unreachable machine."""
    folder = tmp_path / "capture"
    result = by_script(small_rig, *SMALL, "--part", "1/52", "-o", folder)
    assert result.returncode == 0, result.stderr
    with sharing.Member(folder) as silent:
        silent._ended.set()
        assert silent.claim("right+0005.png", 0)
        began_s = time.monotonic()
        result = by_script(small_rig, *SMALL, "--silence", 5, "-o", folder)
        assert result.returncode == 0, result.stderr
        assert time.monotonic() - began_s > 5.0
    assert contents(folder) == contents(by_one)


def test_a_frozen_process_that_wakes_up_after_the_end_changes_nothing(
    by_one: Path, small_rig: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "capture"
    frozen = start(small_rig, folder)
    assert frozen.stdout is not None
    for line in frozen.stdout:
        if json.loads(line)["done"] >= 2:
            break
    children = Path(f"/proc/{frozen.pid}/task/{frozen.pid}/children").read_text()
    processes = [frozen.pid, *map(int, children.split())]
    try:
        for process in processes:
            os.kill(process, signal.SIGSTOP)
        result = by_script(small_rig, *SMALL, "--silence", 5, "-o", folder)
        assert result.returncode == 0, result.stderr
        assert contents(folder) == contents(by_one)
    finally:
        for process in processes:
            os.kill(process, signal.SIGCONT)
    _, complaint = frozen.communicate(timeout=60)
    assert (frozen.returncode, complaint) == (0, "")
    assert contents(folder) == contents(by_one)


def test_a_process_that_slept_after_its_claim_keeps_the_complete_capture(
    tmp_path: Path,
) -> None:
    whole = tmp_path / "capture.json"
    with sharing.Member(tmp_path) as asleep, sharing.Member(tmp_path) as other:
        assert asleep.claim("left+0001.png", 0)
        whole.write_text("{}")
        other.end()
        asleep.begin()
        assert whole.is_file()
        assert asleep.is_over


def test_an_image_that_is_filmed_again_makes_the_capture_incomplete(
    tmp_path: Path,
) -> None:
    whole = tmp_path / "capture.json"
    whole.write_text("{}")
    with sharing.Member(tmp_path) as member:
        assert member.claim("left+0001.png", 0)
        member.begin()
        assert not whole.exists()
        member.begin()


def test_parts_make_a_whole(by_one: Path, small_rig: Path, tmp_path: Path) -> None:
    folder = tmp_path / "capture"
    for part, files in (("4/4", 15), ("1-2/4", 41)):
        result = by_script(small_rig, *SMALL, "--part", part, "-o", folder)
        assert result.returncode == 0, result.stderr
        assert len([f for f in contents(folder) if f[-3:] in ("png", "npy")]) == files
    assert not (folder / "capture.json").exists()
    result = by_script(small_rig, *SMALL, "-o", folder)
    assert result.returncode == 0, result.stderr
    assert contents(folder) == contents(by_one)


@pytest.fixture
def members(tmp_path: Path) -> Iterator[Any]:
    """The `Member` objects of two processes, as on two machines, and a clock of the second one that the test sets."""
    with (
        sharing.Member(tmp_path, 60.0) as first,
        sharing.Member(tmp_path, 60.0) as second,
    ):
        yield first, second


def test_wrong_clocks_do_not_matter(
    members: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first machine's clock is an hour late, then an hour early; only changes of the heartbeat matter."""
    first, second = members
    assert first.claim("image", 0) and not second.claim("image", 0)
    now_s = time.monotonic()
    heartbeat = first.scratch / sharing.HEARTBEAT
    for hours, passed_s in ((-1, 0.0), (1, 59.0), (-1, 118.0)):
        for path in (heartbeat, tmp_path / ".film/claims/image.0"):
            os.utime(path, (time.time() + 3600 * hours,) * 2)
        monkeypatch.setattr(time, "monotonic", lambda s=passed_s: now_s + s)
        assert not second.may_claim("image", 1)
        time.sleep(1.5 * sharing.BEAT_S)  # the first process writes a heartbeat


def test_only_one_inherits(members: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A claim whose owner has ended is free immediately; an incomplete claim is free after the silence."""
    first, second = members
    with sharing.Member(first.capture) as third:
        assert third.claim("image", 0)
        assert not first.may_claim("image", 1)
    assert first.may_claim("image", 1) and second.may_claim("image", 1)
    assert first.claim("image", 1) and not second.claim("image", 1)
    assert not second.may_claim("image", 2)

    (first.claims / "broken.0").touch()
    now_s = time.monotonic()
    assert not second.may_claim("broken", 1)
    monkeypatch.setattr(time, "monotonic", lambda: now_s + 61.0)
    assert second.may_claim("broken", 1)
