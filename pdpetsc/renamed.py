"""Old public names, which warn and go with the next release."""

from __future__ import annotations

import warnings
from collections.abc import Mapping


def warn(old: str, new: str, level: int = 3) -> None:
    """Warn that a name has changed, at the line that uses it, so many calls up."""
    warnings.warn(f"{old} is now {new}; the old name goes with the next release.", FutureWarning, stacklevel=level)


def accept_old_methods(kind: type, names: Mapping[str, str]) -> None:
    """Let a class that a user derives define methods by their old names.

    Parameters
    ----------
    kind : type
        The derived class.
    names : mapping
        New name of each old one.
    """
    for old, new in names.items():
        if old in vars(kind) and new not in vars(kind):
            warn(f"{kind.__name__}.{old}", new, 4)
            setattr(kind, new, vars(kind)[old])
