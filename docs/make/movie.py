"""Make docs/assembly.webp: a recording played in the view. ``python -m docs.make.movie FILE``.

A headless Chromium shows the view paused, moment by moment; each is one frame. Needs a Chromium
and Pillow, which matplotlib brings.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
FILE = ROOT / "docs/assembly.webp"
SIZE = 1280, 800  # of the page [px]
SHOWN = 960, 600  # of the picture [px]
LARGEST_BYTES = 3_000_000
DATA = "document.documentElement.dataset"
SEEK = "document.getElementById('seek')"


def main() -> int:
    """Play a recording and store it as an animated picture."""
    parser = argparse.ArgumentParser(prog="python -m docs.make.movie", description=__doc__)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--first-s", type=float, default=5.0)
    parser.add_argument("--last-s", type=float, default=25.0)
    parser.add_argument("--step-s", type=float, default=0.25)
    parser.add_argument("--rate", type=float, default=2.0, help="times real time")
    parser.add_argument("--quality", type=int, default=60)
    args = parser.parse_args()
    sys.path.insert(0, str(ROOT / "tests"))
    from browser import Browser
    from rerun import viewing

    count = round((args.last_s - args.first_s) / args.step_s) + 1
    frames = []
    with (
        tempfile.TemporaryDirectory() as name,
        Browser(Path(name), *SIZE) as page,
        viewing(args.recording) as address,
    ):
        page.open(f"{address}?paused&t={0.5 * (args.first_s + args.last_s)}")
        page.until(f"{DATA}.tcp && Number({DATA}.foreseen) > 2", 120.0)
        page.value(f"{SEEK}.value = '1'; {SEEK}.oninput()")
        length = float(page.value("document.getElementById('time').textContent").split()[0])
        for index in range(count):
            moment = args.first_s + index * args.step_s
            page.value(f"{SEEK}.value = '{moment / length}'; {SEEK}.oninput()")
            time.sleep(0.3)  # The predicted horizons come from another process.
            page.picture(Path(name) / "frame.png")
            with Image.open(Path(name) / "frame.png") as picture:
                frames.append(picture.convert("RGB").resize(SHOWN, Image.Resampling.LANCZOS))
        page.open("about:blank")
    frames[0].save(
        FILE,
        save_all=True,
        append_images=frames[1:],
        duration=round(1000 * args.step_s / args.rate),
        loop=0,
        quality=args.quality,
        method=6,
    )
    size = FILE.stat().st_size
    print(f"{FILE}: {count} frames, {size / 1e6:.2f} MB")
    return 0 if size <= LARGEST_BYTES else 1


if __name__ == "__main__":
    sys.exit(main())
