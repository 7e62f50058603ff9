"""The pictures of the gallery, by its own commands: `python
notebooks/pictures/draw_gallery.py`.

It takes some minutes, and works in a folder of its own.
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

FOLDER = Path(__file__).parent
BOOK, DATA = FOLDER.parent / "book", FOLDER.parents[1] / "data"
FIT, PROFILE = "jensen_shegelski_2004-fit", "jensen_shegelski_2004-profile"
PICTURES = {
    "fit": f"{FIT}/fit",
    "corner": f"{FIT}/corner",
    "joint": "joint-fit/joint",
    "compare": "jensen_shegelski_2004-compare/compare",
    "profile": f"{PROFILE}-mu1_xi/profile",
    "flat": "consistent/profile",
    "pair": f"{PROFILE}-mu1_eta-mu2_eta/profile",
    "predict": "jensen_shegelski_2004-predict/predict",
    **{name: f"design/{name}" for name in ("design-map", "design-errors")},
}
"""Names of the pictures, and the files that the commands write."""
COLOURS = 128  # a third of the size


def commands(page: str) -> list[str]:
    """The lines of the blocks of commands of a page."""
    text = (BOOK / page).read_text(encoding="utf-8")
    blocks = re.findall(r"```bash\n(.*?)```", text, re.S)
    return [line for block in blocks for line in block.splitlines()]


def main() -> None:
    """Run the commands and keep their pictures."""
    simulated = [line for line in commands("many_throws.md") if " simulate " in line]
    with tempfile.TemporaryDirectory() as scratch:
        shutil.copytree(DATA, Path(scratch) / "data")
        for line in [*simulated, *commands("gallery.md")]:
            words = [sys.executable, "-m", *shlex.split(line)]
            subprocess.run(words, cwd=scratch, check=True, stdout=subprocess.DEVNULL)
        for name, file in PICTURES.items():
            with Image.open(Path(scratch) / f"{file}.png") as picture:
                few = picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
            few.save(FOLDER / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()
