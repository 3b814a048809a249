"""Draw the pictures of docs/gallery.md again: `python tools/gallery.py [FOLDER]` (about two minutes of CPU).

Each picture is a figure of one command, run on the campaign that `bayes-damper examples` writes, and made small: at
most 900 pixels wide, 48 colours. FOLDER keeps campaign and results; without it they go when the pictures are drawn.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

DOCS = Path(__file__).resolve().parent.parent / "docs" / "gallery"
COMMANDS = (
    "examples --out example",
    "diagnose example --out example/diagnose",
    "fit example --effect spring_cubic --out example/fit",
    "plan example --out example/plan",
)
PICTURES = {
    "gap": "example/diagnose/gap.png",
    "ranking": "example/diagnose/ranking.png",
    "missing_torque": "example/diagnose/missing_torque.png",
    "records": "example/fit/large/records.png",
    "corner": "example/fit/large/corner.png",
    "plan": "example/plan/plan.png",
}
"""Name in docs/gallery -> the figure that it is made from."""
WIDEST, COLOURS = 900, 48


def draw(folder: Path) -> None:
    """Run the commands in a folder and write the pictures."""
    for command in COMMANDS:
        print(f"bayes-damper {command}", flush=True)
        subprocess.run([sys.executable, "-m", "bayes_damper", *command.split(), "--quiet"], cwd=folder, check=True)
    DOCS.mkdir(exist_ok=True)
    for name, source in PICTURES.items():
        picture = Image.open(folder / source).convert("RGB")
        picture.thumbnail((WIDEST, 2 * WIDEST))
        picture.quantize(COLOURS, dither=Image.Dither.NONE).save(DOCS / f"{name}.png", optimize=True)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        draw(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as made:
            draw(Path(made))
