"""What other programs read of each output of `stlfr render`, as a table.

.venv/bin/python tests/bench/opened.py CAPTURE [--program PROGRAM]

Renders 9 frames along `sweep`, with `--preset draft`, into every format. Readers: FFmpeg; OpenCV; Chromium, from a
server on this machine; Blender; and the OpenEXR project's own library, which pip installs into a temporary folder.
A row has the reader, the size in pixels, the number of frames if the reader tells, and the mean absolute difference
from the PNG of the same frame, in 1/255. The exit code is 1 if a size or a number of frames is wrong, or if a
difference is larger than `LIMIT`. It needs `stlfr setup`.
"""

from __future__ import annotations

import argparse
import functools
import http.server
import json
import queue
import re
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any

import bpy
import cv2
import imageio_ffmpeg
import numpy as np
import numpy.typing as npt
from light import encoded

ROOT = Path(__file__).resolve().parents[2]
FRAMES = 9
MIDDLE = FRAMES // 2
LIMIT = {"png": 0.001, "exr": 1.0, "jpg": 3.0, "mp4": 5.0, "webm": 5.0, "gif": 8.0}
"""By format: the largest allowed mean difference from the PNG, 1/255. For PNG, it is rounding in single precision."""
VIDEOS = ("mp4", "webm", "gif")
OPENEXR = "OpenEXR==3.3.5"

Picture = npt.NDArray[np.float64]
"""Height x width x 3, blue first, 0 to 255."""
Read = tuple[tuple[int, int], int | None, Picture | None]
"""Width and height, the number of frames, and the middle frame."""

PAGE = """<!doctype html><body><script>
const file = FILE, isVideo = /mp4|webm/.test(file), time = TIME;
const item = document.createElement(isVideo ? 'video' : 'img');
const draw = (w, h) => {
  const canvas = document.createElement('canvas');
  canvas.width = w; canvas.height = h;
  canvas.getContext('2d').drawImage(item, 0, 0);
  canvas.toBlob((png) => fetch('/', {method: 'POST', body: png}));
};
if (isVideo) {
  item.muted = true; item.preload = 'auto';
  item.onloadeddata = () => { item.currentTime = time; };
  item.onseeked = () => draw(item.videoWidth, item.videoHeight);
} else {
  item.onload = () => draw(item.naturalWidth, item.naturalHeight);
}
item.onerror = () => fetch('/', {method: 'POST', body: 'refused'});
// The browser can seek in a blob, but not in a file of a server without range requests.
fetch(file).then((sent) => sent.blob()).then((blob) => { item.src = URL.createObjectURL(blob); });
document.body.append(item);
</script>"""
FPS = 4


def by_ffmpeg(file: Path) -> Read:
    """Decode all frames."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(file)]
    said = subprocess.run(command, check=False, capture_output=True, text=True).stderr
    found = re.search(r"Video: .*?, (\d+)x(\d+)", said)
    assert found is not None, said
    width, height = int(found[1]), int(found[2])
    command += ["-f", "rawvideo", "-pix_fmt", "bgr24", "-"]
    raw = subprocess.run(command, check=True, capture_output=True).stdout
    frames = np.frombuffer(raw, np.uint8).reshape(-1, height, width, 3)
    middle = frames[min(MIDDLE, len(frames) - 1)].astype(np.float64)
    return (width, height), len(frames), middle


def by_opencv(file: Path) -> Read:
    """Read one image."""
    image = cv2.imread(str(file), cv2.IMREAD_COLOR)
    assert image is not None, file
    return (image.shape[1], image.shape[0]), None, image.astype(np.float64)


class Server(http.server.SimpleHTTPRequestHandler):
    """Gives a folder's files, and takes what a page sends."""

    sent: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def do_POST(self) -> None:
        self.sent.put(self.rfile.read(int(self.headers["Content-Length"])))
        self.send_response(204)
        self.end_headers()

    def log_message(self, *_: object) -> None: ...


def by_chromium(file: Path) -> Read:
    """Draw a picture, or the middle of a video, on the canvas of a page, which sends it back."""
    at_s = (MIDDLE + 0.5) / FPS
    name = json.dumps(file.name)
    page = PAGE.replace("FILE", name).replace("TIME", str(at_s))
    file.with_name("page.html").write_text(page)
    serve = functools.partial(Server, directory=str(file.parent))
    with (
        http.server.ThreadingHTTPServer(("127.0.0.1", 0), serve) as server,
        tempfile.TemporaryDirectory() as profile,
    ):
        threading.Thread(target=server.serve_forever, daemon=True).start()
        command = ["chromium", "--headless=new", "--no-sandbox", "--disable-gpu"]
        command += ["--disable-dev-shm-usage", f"--user-data-dir={profile}/profile"]
        command += ["--remote-debugging-port=0"]
        command += [f"http://127.0.0.1:{server.server_port}/page.html"]
        browser = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        try:
            png = np.frombuffer(Server.sent.get(timeout=60), np.uint8)
        finally:
            browser.kill()
            browser.wait()
            server.shutdown()
    image = cv2.imdecode(png, cv2.IMREAD_COLOR)
    assert image is not None, f"Chromium doesn't show {file.name}"
    size = (image.shape[1], image.shape[0])
    is_middle = file.suffix != ".gif"  # It may show any frame of a GIF.
    return size, None, image.astype(np.float64) if is_middle else None


def by_blender(file: Path) -> Read:
    """Load it as an image, or as a movie clip."""
    if file.suffix in (".mp4", ".webm", ".gif"):
        clip = bpy.data.movieclips.load(str(file))
        return (clip.size[0], clip.size[1]), clip.frame_duration, None
    image = bpy.data.images.load(str(file))
    width, height = image.size
    if (
        image.type == "MULTILAYER"
    ):  # Its pixels are those of its layers; see tests/python/test_motion_layers.py.
        return (width, height), None, None
    rgba = np.array(image.pixels[:]).reshape(height, width, 4)
    picture = rgba[::-1, :, 2::-1].astype(np.float64)
    is_linear = file.suffix == ".exr"
    return (width, height), None, 255.0 * (encoded(picture) if is_linear else picture)


def by_openexr(file: Path, packages: Path) -> Read:
    """Read a file by the library of the format's makers, in a process of its own."""
    script = (
        "import sys; sys.path.insert(0, sys.argv[2])\n"
        "import OpenEXR, numpy as np\n"
        "with OpenEXR.File(sys.argv[1], separate_channels=True) as file:\n"
        "    channels = file.channels()\n"
        "    np.savez(sys.argv[3], **{n: c.pixels for n, c in channels.items()})\n"
    )
    out = file.with_suffix(".npz")
    command = [sys.executable, "-I", "-c", script, str(file), str(packages), str(out)]
    subprocess.run(command, check=True)
    with np.load(out) as channels:
        names = sorted(channels.files)
        linear = np.stack([channels[c] for c in "BGR"], axis=2).astype(np.float64)
    print(f"OpenEXR: channels {', '.join(names)}", file=sys.stderr)
    return (linear.shape[1], linear.shape[0]), None, 255.0 * encoded(linear)


def main() -> None:
    """Render, read, print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("capture", type=Path)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/stlfr")
    a = parser.parse_args()
    is_right = True
    print("| format | reader | size, px | frames | difference, 1/255 |")
    print("|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        scratch = Path(folder)
        packages = scratch / "packages"
        command = [sys.executable, "-m", "pip", "install", "-q", "--target", packages]
        subprocess.run([*map(str, command), "--no-deps", OPENEXR], check=True)
        command = [a.program, "-q", "render", a.capture, "--path", "sweep"]
        command += ["--duration", str((FRAMES - 1) / FPS), "--fps", str(FPS)]
        for name in LIMIT:
            out = f"x.{name}" if name in VIDEOS else f"%04d.{name}"
            command_of = [*command, "--preset", "draft", "-o", scratch / name / out]
            (scratch / name).mkdir()
            subprocess.run(list(map(str, command_of)), check=True)
        size, _, truth = by_opencv(scratch / f"png/{MIDDLE:04d}.png")
        for name, limit in LIMIT.items():
            is_video = name in VIDEOS
            file = (
                scratch / name / (f"x.{name}" if is_video else f"{MIDDLE:04d}.{name}")
            )
            readers: dict[str, Any] = {"Blender": by_blender}
            if name == "exr":
                readers["OpenEXR"] = functools.partial(by_openexr, packages=packages)
            else:
                readers["Chromium"] = by_chromium
                by = {"FFmpeg": by_ffmpeg} if is_video else {"OpenCV": by_opencv}
                readers |= by
            for reader, read in readers.items():
                found, frames, image = read(file)
                off = None
                if image is not None and truth is not None and found == size:
                    off = float(np.abs(image - truth).mean())
                is_right &= found == size and frames in (None, FRAMES)
                is_right &= off is None or off <= limit
                shown = "" if off is None else f"{off:.2f}"
                print(
                    f"| {name} | {reader} | {found[0]}x{found[1]} | {frames or ''} | {shown} |",
                    flush=True,
                )
    sys.exit(0 if is_right else 1)


if __name__ == "__main__":
    main()
