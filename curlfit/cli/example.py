"""`curlfit example`: copies of the example data and notebooks that can be changed."""

from __future__ import annotations

from pathlib import Path

from curlfit.foreign import say

_PACKAGE = Path(__file__).parents[1]
_PATTERN_BY_PART = {"data": "*", "notebooks": "*.ipynb"}
_FIRST_FILE = "data/jensen_shegelski_2004.csv"


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
    of_wheel = _PACKAGE / "examples"
    of_clone = _PACKAGE.parent
    if (of_wheel / _FIRST_FILE).is_file():
        source = of_wheel
    elif (of_clone / _FIRST_FILE).is_file():
        source = of_clone
    else:
        raise InputError(f"this installation has no examples ({of_wheel} is missing)")
    if folder.exists() and not folder.is_dir():
        raise InputError(
            f"{folder}: a file; expected a folder, or a name that is not taken"
        )
    for part, pattern in _PATTERN_BY_PART.items():
        prepare_folder(folder / part)
        for file in sorted((source / part).glob(pattern)):
            target = folder / part / file.name
            if target.exists():
                say(f"Left as it is: {target}")
            elif file.is_file():
                atomic_write(target, file.read_bytes())
                say(f"Written: {target}")
    say(f"\nTry: cd {folder} && curlfit fit {_FIRST_FILE}")
