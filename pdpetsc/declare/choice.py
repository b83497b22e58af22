"""Choice of objects by words, such as ``silling`` for a control on the command line."""

from collections.abc import Mapping
from typing import TypeVar

from pdpetsc.errors import CaseError

T = TypeVar("T")


def choose(parameter: str, word: str, choices: Mapping[str, T]) -> T:
    """Return the object of a word.

    Parameters
    ----------
    parameter : str
        Name of the parameter of the case, for the message.
    word : str
        Its value.
    choices : mapping of str to object
        The object of each word.

    Raises
    ------
    CaseError
        No choice has that name.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> pd.choose("scheme", "stress_points", pd.SCHEMES)
    StressPoints(seed=1)
    """
    if word not in choices:
        raise CaseError(f"{parameter} is one of {', '.join(choices)}, not {word!r}.")
    return choices[word]
