"""Makes every picture of gallery.md, by running what the page itself says, block by block and in order.

    python docs/gallery.py [--out docs/img] [--work FOLDER] [--size 960x540] [--only NAME ...]

A block of python runs; a block of toml whose first line is a comment with a file's name becomes that file; every line of a
block of sh that begins with `stereorelight` runs as that command.  All of it in one folder.  Then NAME.png, or NAME_1.png, NAME_2.png ... side
by side, become gallery_NAME.jpg for every picture that the page shows.  `--only` writes these pictures alone; the blocks all run."""

from __future__ import annotations

import argparse
import os
import re
import shlex
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

PAGE = Path(__file__).with_name("gallery.md")
BLOCK = re.compile(r"^```(python|toml|sh)\n(.*?)^```$", re.M | re.S)
SHOWN = re.compile(r"\(img/gallery_(\w+)\.jpg\)")
WIDEST_PX, SINGLE_PX = 1440, 720
MOST_BYTES = 200_000


def run_page(text: str, folder: Path, size: tuple[int, int]) -> None:
    """Run the page's blocks in `folder`, which becomes the current one meanwhile."""
    import click.testing

    from stereorelight.cli import main

    room: dict[str, Any] = {"SIZE": size, "__name__": "gallery"}
    before = Path.cwd()
    os.chdir(folder)
    try:
        for kind, body in BLOCK.findall(text):
            if kind == "toml":
                name = body.partition("\n")[0].lstrip("# ").split()[0]
                Path(name).write_text(body, encoding="utf-8")
            elif kind == "python":
                body = re.sub(r"^SIZE = .*$", "", body, flags=re.M)
                exec(compile(body, str(PAGE), "exec"), room)
            else:
                for line in body.replace("\\\n", " ").splitlines():
                    words = shlex.split(line.partition(" #")[0])
                    if words[:1] != ["stereorelight"]:
                        continue
                    small = [word.replace("960x540", f"{size[0]}x{size[1]}") if size[0] < 960 else word for word in words[1:]]
                    result = click.testing.CliRunner().invoke(main, small)
                    if result.exit_code:
                        raise SystemExit(f"{line}\n{result.output}{result.exception or ''}")
    finally:
        os.chdir(before)


def pasted(name: str, folder: Path) -> np.ndarray:
    """(h, w, 3) uint8: the parts of a picture side by side, at most `WIDEST_PX` wide."""
    import cv2

    parts = [folder / f"{name}.png"] if (folder / f"{name}.png").exists() else sorted(folder.glob(f"{name}_[0-9].png"))
    if not parts:
        raise SystemExit(f"{PAGE.name} shows gallery_{name}.jpg, and no block made {name}.png")
    width = min(SINGLE_PX, (WIDEST_PX - 6 * (len(parts) - 1)) // len(parts))
    pictures = []
    for part in parts:
        picture = cv2.imread(str(part))
        height = round(picture.shape[0] * width / picture.shape[1])
        pictures.append(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA) if picture.shape[1] > width else picture)
    gap = np.full((pictures[0].shape[0], 6, 3), 255, np.uint8)
    return np.hstack([piece for picture in pictures for piece in (gap, picture)][1:])


def write_jpeg(path: Path, picture: np.ndarray) -> None:
    """As good as `MOST_BYTES` allow."""
    import cv2

    for quality in range(92, 50, -4):
        _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
        if len(data) <= MOST_BYTES:
            break
    path.write_bytes(data.tobytes())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=PAGE.parent / "img")
    parser.add_argument("--work", type=Path)
    parser.add_argument("--size", default="960x540")
    parser.add_argument("--only", nargs="*", default=[])
    told = parser.parse_args()
    width, height = (int(n) for n in told.size.split("x"))
    text = PAGE.read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as temporary:
        folder = told.work or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        run_page(text, folder, (width, height))
        told.out.mkdir(parents=True, exist_ok=True)
        for name in dict.fromkeys(SHOWN.findall(text)):
            if not told.only or name in told.only:
                write_jpeg(told.out / f"gallery_{name}.jpg", pasted(name, folder))
                print(f"gallery_{name}.jpg", file=sys.stderr)


if __name__ == "__main__":
    main()
