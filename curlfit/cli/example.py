"""`curlfit example`: copies of the example data and notebooks that can be changed."""

from __future__ import annotations

from pathlib import Path

from curlfit.foreign import say

_PACKAGE = Path(__file__).parents[1]
_PARTS = {"data": "*", "notebooks": "*.ipynb"}
_FIRST = "data/jensen_shegelski_2004.csv"


def example(
    folder: Path = Path("curlfit-examples"),
    /,
) -> None:
    """Copy the example data and the notebooks to a folder of your own.

    Files that are there already are left as they are.

    Parameters
    ----------
    folder
        Destination folder; created if it does not exist. [default: curlfit-examples]
    """
    from curlfit.errors import InputError
    from curlfit.output.files import atomic_write, prepare_folder

    # a wheel has them in a folder of its own, a clone beside the package
    source = next(
        (
            root
            for root in (_PACKAGE / "examples", _PACKAGE.parent)
            if (root / _FIRST).is_file()
        ),
        None,
    )
    if source is None:
        raise InputError(
            f"this installation has no examples ({_PACKAGE / 'examples'} is missing)"
        )
    if folder.exists() and not folder.is_dir():
        raise InputError(
            f"{folder}: a file; expected a folder, or a name that is not taken"
        )
    for part, pattern in _PARTS.items():
        prepare_folder(folder / part)
        for file in sorted((source / part).glob(pattern)):
            target = folder / part / file.name
            if target.exists():
                say(f"Left as it is: {target}")
            elif file.is_file():
                atomic_write(target, file.read_bytes())
                say(f"Written: {target}")
    say(f"\nTry: cd {folder} && curlfit fit {_FIRST}")
